"""A simulated USB bus under pyusb."""
