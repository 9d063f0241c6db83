"""Linux asks udev who may open a device: the rules that let the person at the computer do it."""

import re

RULES_FILE = "/etc/udev/rules.d/70-nlos.rules"
RELOAD = "sudo udevadm control --reload && sudo udevadm trigger, then plug the device in again"

_USB = 'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{:04x}", ATTR{{idProduct}}=="{:04x}", TAG+="uaccess"'
_TTY = 'SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{:04x}", SYMLINK+="{}", TAG+="uaccess", ENV{{ID_MM_DEVICE_IGNORE}}="1"'


def usb_rule(vendor_id: int, product_id: int) -> str:
    """The rule for a USB instrument."""
    return _USB.format(vendor_id, product_id)


def vendor_of(rule: str) -> int | None:
    """The USB vendor id that a rule is for."""
    named = re.search(r'idVendor}=="([0-9a-f]{4})"', rule)
    return int(named[1], 16) if named else None


def tty_rule(vendor_id: int, name: str) -> str:
    """The rule for a serial port, which also gives it a name that stays, `/dev/<name>`, and keeps ModemManager away:
    it greets every new port with modem commands, and a mirror controller keeps half a line for the next one."""
    return _TTY.format(vendor_id, name)
