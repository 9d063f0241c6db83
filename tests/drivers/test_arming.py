"""Before the first light: the terminal's place, somebody's word, the warning time."""

import getpass
from pathlib import Path

import pytest

from nlos.configs.load import load
from nlos.drivers.arm_settings import ArmSettings
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import LimitError, ShutterHeld
from nlos.drivers.terminal_place import remote_terminal

FROM_AFAR = {"SSH_CONNECTION": "10.0.0.7 50000 10.0.0.1 22"}


def armed(**arm: object) -> BenchSettings:
    return load("bench", "simulated", BenchSettings).settings.model_copy(update={"arm": ArmSettings(**arm)})


def test_a_terminal_that_is_not_at_the_bench_gets_no_light(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in FROM_AFAR.items():
        monkeypatch.setenv(name, value)
    with open_bench(armed()) as bench:
        with pytest.raises(LimitError, match="not at the bench"):
            bench.shutter.open()
        assert bench.simulated is not None
        assert not bench.simulated.shutter_open
    with open_bench(armed(remote=True)) as bench:
        bench.shutter.open()
        assert bench.simulated is not None
        assert bench.simulated.shutter_open


def test_light_waits_for_a_word_where_the_bench_file_wants_one(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def agree(what: str) -> bool:
        asked.append(what)
        return len(asked) > 1

    with open_bench(armed(confirm=True, remote=True), agree=agree) as bench:
        with pytest.raises(LimitError, match="no one agreed"):
            bench.shutter.open()
        for _ in range(3):
            bench.shutter.open()
            bench.shutter.close()
    assert len(asked) == 2  # once more after the no, then never again


def test_who_armed_a_bench_and_from_where_is_written_down(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    here = remote_terminal() or "at the bench"
    for afar in ({}, FROM_AFAR):
        for name, value in afar.items():
            monkeypatch.setenv(name, value)
        with open_bench(armed(remote=True)) as bench:
            bench.on_event = lambda kind, text: told.append(text)
            bench.shutter.open()
            bench.shutter.close()
            bench.shutter.open()
    there = remote_terminal()
    assert there is not None
    assert "10.0.0.7" in there
    who = getpass.getuser()
    assert [each for each in told if "armed" in each] == [f"armed by {who}, {here}", f"armed by {who}, {there}"]


@pytest.mark.parametrize("missing", [KeyError("uid 4711"), OSError("no username"), ImportError("no pwd")])
def test_a_user_without_a_name_may_have_light(missing: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    def getuser() -> str:
        raise missing

    monkeypatch.setattr("getpass.getuser", getuser)
    told: list[str] = []
    with open_bench(armed(remote=True)) as bench:
        bench.on_event = lambda kind, text: told.append(text)
        bench.shutter.open()
        assert bench.simulated is not None
        assert bench.simulated.shutter_open
    assert any(each.startswith("armed by an unnamed user, ") for each in told)


def test_light_that_a_signal_has_shut_already_is_not_announced() -> None:
    told: list[str] = []
    with open_bench(armed(delay_s=5.0, remote=True)) as bench:
        bench.on_event = lambda kind, text: told.append(text)
        bench.shutter.hold("SIGINT")
        bench.shutter.arm()
        assert not [each for each in told if each.startswith("light in")]
        bench.shutter.release()
        bench.shutter.arm()
        assert told[-1] == "light in 5 s"


def test_a_dry_run_asks_nobody_and_announces_no_light(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has none, so it may be begun from anywhere."""
    for name, value in FROM_AFAR.items():
        monkeypatch.setenv(name, value)
    settings, told = armed(confirm=True, delay_s=30.0), []
    dry = settings.model_copy(update={"safety": settings.safety.model_copy(update={"dry_run": True})})
    with open_bench(dry) as bench:
        bench.on_event = lambda kind, text: told.append(text)
        begun_s = bench.clock.now()
        bench.shutter.agree()
        bench.shutter.arm()
        bench.shutter.open()
        assert bench.clock.now() - begun_s < 30.0
        assert bench.simulated is not None
        assert not bench.simulated.shutter_open
    assert told[-1:] == ["asked to open: stays closed in a dry run"]
    assert not [each for each in told if each.startswith(("armed by", "light in"))]


def test_there_is_no_light_after_a_warning_that_was_broken_off_though_somebody_released_the_shutter() -> None:
    with open_bench(armed(delay_s=5.0, remote=True)) as bench:
        assert bench.simulated is not None

        def meanwhile(kind: str, text: str) -> None:
            if text.startswith("light in"):
                bench.shutter.hold("a signal")
            elif text.startswith("no light"):
                bench.shutter.release()

        bench.on_event = meanwhile
        with pytest.raises(ShutterHeld, match="warning time before light was broken off"):
            bench.shutter.open()
        assert not bench.simulated.shutter_open


def test_the_warning_time_passes_before_the_first_light_and_not_again() -> None:
    with open_bench(armed(delay_s=5.0, remote=True)) as bench:
        began_s = bench.clock.now()
        bench.shutter.open()
        first_s = bench.clock.now()
        bench.shutter.close()
        bench.shutter.open()
        assert 5.0 <= first_s - began_s < 5.5
        assert bench.clock.now() - first_s < 0.5


def test_a_computer_that_sleeps_in_the_warning_time_warns_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_bench(armed(delay_s=5.0, remote=True)) as bench:
        slept = [0.1, 0.1, 3600.0]
        passed = bench.clock.sleep
        monkeypatch.setattr(bench.clock, "sleep", lambda s: passed(slept.pop(0) if s == 0.1 and slept else s))
        said: list[tuple[str, float]] = []
        bench.on_event = lambda kind, text: said.append((text, bench.clock.now()))
        bench.shutter.open()
    (first, first_s), (second, second_s), (opened, lit_s), *_ = [each for each in said if "armed" not in each[0]]
    assert (first, second, opened) == ("light in 5 s", "light in 5 s", "opened")
    assert second_s - first_s > 3600
    assert 5.0 <= lit_s - second_s < 5.5


def test_a_real_bench_is_armed_by_default_and_a_simulated_one_is_not() -> None:
    assert load("bench", "lab", BenchSettings).settings.arming == ArmSettings()
    assert load("bench", "simulated", BenchSettings).settings.arming is None


def test_a_shell_without_ssh_variables_is_found_out_by_who_started_it(tmp_path: Path) -> None:
    import os

    for number, line in ((os.getpid(), "1 (python) S 77 0"), (77, "77 (sudo) S 78 0"), (78, "78 (sshd-session) S 1 0")):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / "stat").write_text(line)
    assert remote_terminal({}, tmp_path) == "started by sshd-session"
    assert remote_terminal({}, tmp_path / "nothing") is None
    assert "10.0.0.7" in str(remote_terminal(FROM_AFAR, tmp_path / "nothing"))
