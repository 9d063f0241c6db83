"""When pictures of a film are made with less, so that fewer frames get none."""

FIRST_TRY = 12
"""Pictures in a hurry without a dropped frame, after which one is tried with all; twice as many after each try."""
LONGEST_TRY = 960


class Hurry:
    """On from the beginning, when pictures are latest, and from each dropped frame on, until a single picture with all
    was made as quickly as frames come."""

    def __init__(self) -> None:
        self.on = True
        self._kept_up, self._wanted, self._trying = 0, FIRST_TRY, False

    def next(self) -> bool:
        """Whether the next picture is made with less."""
        if self.on and not self._trying and self._kept_up >= self._wanted:
            self._trying = True
            return False
        return self.on

    def shown(self, dropped: int, hurried: bool, in_time: bool) -> None:
        """A picture was shown, and so many frames since the one before had none; whether it was made with less, and
        whether pictures that take as long would keep up."""
        self._kept_up = 0 if dropped else self._kept_up + 1
        if self._trying and not hurried:
            self._trying, self._kept_up, self._wanted = False, 0, min(2 * self._wanted, LONGEST_TRY)
            self.on = not in_time
        self.on |= dropped > 0
