"""Bytes on a wire: serial lines, USBTMC, SCPI."""
