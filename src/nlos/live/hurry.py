"""When pictures of a film are made with less, so that fewer frames get none."""

FIRST_TRY = 30
"""Pictures in a hurry without a dropped frame, after which all is tried again; twice as many after each vain try."""
LONGEST_TRY = 960


class Hurry:
    """On from the first dropped frame until the machine seems to have time again."""

    def __init__(self) -> None:
        self.on = False
        self._kept_up, self._wanted = 0, FIRST_TRY

    def shown(self, dropped: int) -> None:
        """A picture was shown, and so many frames since the one before had none."""
        self._kept_up = 0 if dropped else self._kept_up + 1
        if dropped and not self.on:
            self.on = True
        elif self.on and self._kept_up >= self._wanted:
            self.on, self._kept_up, self._wanted = False, 0, min(2 * self._wanted, LONGEST_TRY)
