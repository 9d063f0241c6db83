"""What the `arm` block of a bench file may say: what has to happen before the first light."""

from pydantic import Field

from nlos.configs.settings import Settings


class ArmSettings(Settings):
    """Before the shutter opens for the first time of a command. A simulated bench without this block needs none of it;
    on a real one `remote: false` holds also where the block is not there."""

    delay_s: float = Field(default=0.0, ge=0, le=60)
    """Warning time, announced once everything else is ready, before the first light."""
    confirm: bool = False
    """Somebody at the terminal has to type a word first."""
    remote: bool = False
    """Whether a terminal that is not at the bench (SSH, mosh) may switch on light."""
