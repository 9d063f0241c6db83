"""Methods that need nothing but NumPy and SciPy: where torch is not installed, these reconstruct."""
