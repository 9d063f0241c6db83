"""Where pyserial looks for `sim://`: it imports `protocol_<scheme>` from the packages it was told of."""

from nlos.drivers.simulated.serial.port import SimulatedSerial as Serial

__all__ = ["Serial"]
