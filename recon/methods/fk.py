"""f-k migration: runs the measured light back as a wave; robust for glossy and mixed surfaces."""

import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.front_view import middle_map
from nlos.recon.physics import prepare
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.fk_migration import FkMigration
from nlos.recon.volume_method import VolumeMethod
from nlos.recon.without_torch.fk import Settings


class Migration(VolumeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) squared magnitude. Source: Lindell et al., ACM TOG 38(4), 2019."""

    depth_by = staticmethod(middle_map)

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.falloff = Falloff(time, settings.falloff, settings.conventions)
        self.migrate = FkMigration(wall, time, settings.conventions)

    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The intensity of the migrated wave, whose amplitude at the wall is the root of the counts; a `response`
        (B, K) is undone along time first: the root would not let the wave's own steps hold it."""
        signal, _ = prepare(counts, exposure_s, self.settings, self.time, self.falloff, response)
        amplitude = signal.clamp_(min=0).sqrt_()
        field: torch.Tensor = self.migrate(amplitude)
        return field.real.square().addcmul_(field.imag, field.imag)


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> Migration:
    """The migration for one geometry."""
    assert isinstance(settings, Settings)
    return Migration(settings, wall, time)
