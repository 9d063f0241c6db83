"""What the doctor asks of a person's hands: a lamp, a cable, the interlock. On a simulated bench it does so itself."""

from collections.abc import Mapping
from typing import Protocol

from nlos.cli.agreeing import answer, somebody_is_there
from nlos.cli.terminal import terminal
from nlos.doctor.gates import axis_of, gates
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault

_LAMP_CPS = 1e6
_PULLED_AFTER_S = 0.5
_LOOK_S, _GLANCE_S = 5.0, 0.1


class Hands(Protocol):
    """Each returns whether it is done, or asked for in words that somebody reads; False: nobody is there."""

    def lamp(self, on: bool) -> bool:
        """Steady light, of no laser, on the detector."""
        ...

    def cover(self, on: bool) -> bool:
        """Something opaque over the detector, or away again."""
        ...

    def spot(self, bench: Bench, place: tuple[float, float]) -> tuple[float, float] | None:
        """Where on the wall (x_m, y_m) the beam is that was sent to `place`; None where nobody measured it."""
        ...

    def pull_mirror_cable(self) -> bool:
        """Within the next minute, while the doctor watches."""
        ...

    def replug(self) -> bool:
        """It is plugged in again."""
        ...

    def ready_to_open_interlock(self) -> bool:
        """Somebody will open the loop as soon as there is light."""
        ...

    def open_interlock(self) -> None:
        """There is light."""
        ...

    def close_interlock(self) -> bool:
        """The loop is closed again."""
        ...


class SimulatedHands:
    """The same, done to a simulated table."""

    def __init__(self, bench: Bench, table: SimulatedBench) -> None:
        self._settings, self._table = bench.settings, table
        self._before = table.light

    def lamp(self, on: bool) -> bool:
        return self._light(on, {"ambient_cps": _LAMP_CPS})

    def cover(self, on: bool) -> bool:
        return self._light(on, {"ambient_cps": 0.0, "direct_cps": 0.0, "hidden_cps": 0.0})

    def _light(self, changed: bool, rates: Mapping[str, float]) -> bool:
        from nlos.drivers.simulated.instruments import light_of

        settings = self._settings
        if changed:
            assert settings.simulation is not None
            scene = settings.simulation.scene.model_copy(update=rates)
            simulation = settings.simulation.model_copy(update={"scene": scene})
            settings = settings.model_copy(update={"simulation": simulation})
            self._before = self._table.light
            self._table.light = light_of(settings)
        else:
            self._table.light = self._before
        return True

    def spot(self, bench: Bench, place: tuple[float, float]) -> tuple[float, float] | None:
        seen = self._table.spot_m(self._table.beam)
        return None if seen is None else (round(seen[0], 3), round(seen[1], 3))

    def pull_mirror_cable(self) -> bool:
        name = MIRRORS[self._settings.mirror.model].pulled
        self._table.faults.add(Fault(name=name, after_s=self._table.clock.now() + _PULLED_AFTER_S))
        return True

    def replug(self) -> bool:
        return True

    def ready_to_open_interlock(self) -> bool:
        return True

    def open_interlock(self) -> None:
        self._table.interlock_closed = False

    def close_interlock(self) -> bool:
        self._table.interlock_closed = True
        return True


class PersonsHands:
    """Somebody at the terminal, who presses Enter when it is done; any word instead of it: not today."""

    def lamp(self, on: bool) -> bool:
        if on:
            return _asked("Shine a steady lamp (a torch, not a fluorescent tube) on the wall or the detector.")
        return _asked("Take the lamp away.")

    def cover(self, on: bool) -> bool:
        return _asked("Cover the detector, light-tight." if on else "Uncover the detector again.")

    def spot(self, bench: Bench, place: tuple[float, float]) -> tuple[float, float] | None:
        x_m, y_m = place
        if not _asked(
            f"After Enter the beam is on for {_LOOK_S:g} s at ({x_m:+.3f}, {y_m:+.3f}) m: mark where it lands."
        ):
            return None
        bench.counter.configure(axis_of(bench))
        bench.shutter.release()
        bench.shutter.open()
        try:
            for each in gates(bench, [_GLANCE_S] * round(_LOOK_S / _GLANCE_S)):
                bench.shutter.watch(each)
        finally:
            bench.shutter.close()
        said = answer("Where was it? x y in metres, right of and above the wall's centre; Enter alone to skip this.")
        try:
            x_m, y_m = (float(each) for each in (said or "").replace(",", " ").split())
        except ValueError:
            return None
        return x_m, y_m

    def pull_mirror_cable(self) -> bool:
        return _asked("After Enter, pull the mirror controller's cable out of this computer within a minute.")

    def replug(self) -> bool:
        return _asked("Plug the mirror controller's cable in again.")

    def ready_to_open_interlock(self) -> bool:
        return _asked("After Enter the light comes on: open the interlock loop (the door, the key) within a minute.")

    def open_interlock(self) -> None:
        """They have been asked to."""

    def close_interlock(self) -> bool:
        return _asked("Close the interlock loop again.")


class NoHands:
    """Nobody is there to ask."""

    def lamp(self, on: bool) -> bool:
        return False

    def cover(self, on: bool) -> bool:
        return False

    def spot(self, bench: Bench, place: tuple[float, float]) -> tuple[float, float] | None:
        return None

    def pull_mirror_cable(self) -> bool:
        return False

    def replug(self) -> bool:
        return False

    def ready_to_open_interlock(self) -> bool:
        return False

    def open_interlock(self) -> None:
        """Nobody was asked to."""

    def close_interlock(self) -> bool:
        return False


def hands_for(bench: Bench) -> Hands:
    """Whose hands this bench has."""
    if bench.simulated is not None:
        return SimulatedHands(bench, bench.simulated)
    return PersonsHands() if somebody_is_there() else NoHands()


def light_is_agreed_to(where: str) -> bool:
    """Asks in words whether the shutter may open."""
    terminal.log(f"With light: the shutter opens, and the beam goes to {where} on the wall.", -9)
    return answer('Is everybody safe from it? Type "light" to agree, Enter to stay in the dark.') == "light"


def _asked(what: str) -> bool:
    return answer(f"{what} Press Enter when that is done; type anything to skip it.") == ""
