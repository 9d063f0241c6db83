"""What a bench file, or a person's own defaults, say of every run: who measures, where it goes, whom it concerns."""

from typing import Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings


class MailSettings(Settings):
    """A mail by an SMTP server that takes it without a password: a laboratory's relay."""

    server: str
    """Host of the SMTP server."""
    port: int = Field(default=25, ge=1, le=65535)
    """Its port."""
    sender: str
    """Address that it is from."""
    to: tuple[str, ...]
    """Addresses that it goes to."""


class HookSettings(Settings):
    """Who is told when a scan or a series is done, or ended by an alarm: a command, a web address, a mail."""

    done: str | None = None
    """Command for the shell when a run is done; NLOS_RUN, NLOS_STATUS, NLOS_MESSAGE, ... tell it which."""
    alarm: str | None = None
    """The same when an alarm, a trip or an error ended it."""
    webhook: str | None = None
    """Address to which both are posted as JSON."""
    mail: MailSettings | None = None
    """Sends both by mail."""
    deadline_s: float = Field(default=30.0, ge=0.1, le=600)
    """How long each may take; it is ended then, and the next run begins."""

    @model_validator(mode="after")
    def _web_address(self) -> Self:
        if self.webhook is not None and not self.webhook.startswith(("http://", "https://")):
            raise ValueError("webhook must begin with http:// or https://")
        return self

    def __bool__(self) -> bool:
        return any(each is not None for each in (self.done, self.alarm, self.webhook, self.mail))


class RunDefaults(Settings):
    """What applies to every run unless the command line says otherwise; tags add up."""

    sample: str = ""
    """What is behind the corner."""
    operator: str = ""
    """Who measures."""
    note: str = ""
    """Anything worth finding again."""
    tags: tuple[str, ...] = ()
    """Words to find runs by."""
    folder: str = ""
    """Data folder: scans without -o go to FOLDER/2026-03-01/143205-demo-SAMPLE.h5; `~` is the home folder."""
    hooks: HookSettings = HookSettings()
    """Who is told at the end."""
