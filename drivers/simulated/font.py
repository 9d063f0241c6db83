"""Capital letters and digits as bitmaps of 5 x 7 cells: the hidden objects that NLOS labs cut out of cardboard."""

# One byte a row, top to bottom, bit 4 is the leftmost cell; the shapes are those of the HD44780 display's font.
_ROWS = {
    "A": "0E11111F111111", "B": "1E11111E11111E", "C": "0E11101010110E", "D": "1E11111111111E",
    "E": "1F10101E10101F", "F": "1F10101E101010", "G": "0E11101711110F", "H": "1111111F111111",
    "I": "0E04040404040E", "J": "0702020202120C", "K": "11121418141211", "L": "1010101010101F",
    "M": "111B1515111111", "N": "11111915131111", "O": "0E11111111110E", "P": "1E11111E101010",
    "Q": "0E11111115120D", "R": "1E11111E141211", "S": "0F10100E01011E", "T": "1F040404040404",
    "U": "1111111111110E", "V": "11111111110A04", "W": "1111111515150A", "X": "11110A040A1111",
    "Y": "1111110A040404", "Z": "1F01020408101F", "0": "0E11131519110E", "1": "040C040404040E",
    "2": "0E11010204081F", "3": "1F02040201110E", "4": "02060A121F0202", "5": "1F101E0101110E",
    "6": "0608101E11110E", "7": "1F010204080808", "8": "0E11110E11110E", "9": "0E11110F01020C",
}  # fmt: skip

LETTERS = "".join(_ROWS)


def bitmap(letter: str) -> tuple[str, ...]:
    """Seven rows of five characters, `#` for a filled cell. Raises `KeyError` for a letter that is not in `LETTERS`."""
    rows = bytes.fromhex(_ROWS[letter])
    return tuple("".join("#" if row >> (4 - column) & 1 else "." for column in range(5)) for row in rows)
