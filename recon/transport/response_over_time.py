"""An instrument's response undone along time, for methods whose own steps leave no room for it: a Wiener filter.

The power of light and of noise is the data's own, by frequency: noise is white along time and light is not. What lies
beyond the frequency at which light first sinks below a twentieth of the noise is cut: there is nothing to sharpen.
"""

import numpy as np
import numpy.typing as npt
import scipy

from nlos.recon.transport.fourier import threads

Floats = npt.NDArray[np.float64]
FAINTEST = 0.05  # of the noise's power; 0.3 and 1 lose up to 1 dB at one photon a peak
SMOOTHED = 5  # frequencies over which the power of light is averaged
SHORT = 0.7  # of the light in one bin: that is an instant, as far as these bins tell
LEAST_KEPT = 1e-3  # of the response's power: fainter frequencies are not raised any further


def without_response(
    signal: npt.NDArray[np.float32], measured: npt.NDArray[np.bool_], taps: Floats
) -> npt.NDArray[np.float32]:
    """`signal` (T, H, W), less its background, as if recorded in an instant. `measured` (H, W); `taps` (K,): shares of
    light a bin, K odd, the middle one on time."""
    if taps.max() > SHORT:
        return signal
    bins = len(signal)
    length = scipy.fft.next_fast_len(bins + len(taps), real=True)
    spectra = scipy.fft.rfft(signal, length, axis=0, workers=threads())
    gain = _gain(signal[:, measured], spectra[:, measured], taps, length)
    spectra *= gain[:, None, None]
    return np.asarray(scipy.fft.irfft(spectra, length, axis=0, workers=threads())[:bins], dtype=np.float32)


def _gain(
    chosen: npt.NDArray[np.float32], spectra: npt.NDArray[np.complex64], taps: Floats, length: int
) -> npt.NDArray[np.complex64]:
    """Of every frequency (F,), from the points measured, (T, N) and (F, N)."""
    spread = scipy.fft.rfft(np.roll(np.pad(taps, (0, length - len(taps))), -(len(taps) // 2)))
    if not chosen.size or len(chosen) < 3:
        return np.ones(len(spread), dtype=np.complex64)
    noise = len(chosen) * float(np.mean(np.diff(chosen, 2, axis=0) ** 2, dtype=np.float64)) / 6
    power = np.mean(spectra.real**2 + spectra.imag**2, axis=1, dtype=np.float64)
    light = np.convolve(np.maximum(power - noise, 0), np.full(SMOOTHED, 1 / SMOOTHED), mode="same")
    faint = np.flatnonzero(light < FAINTEST * noise)
    light[faint[0] if len(faint) else len(light) :] = 0
    kept = light / np.maximum(light + noise, 1e-300)
    sharpened = kept * spread.conj() / np.maximum(np.abs(spread) ** 2, LEAST_KEPT)
    return np.asarray(sharpened, dtype=np.complex64)
