"""Run by the foreign environment: a PTU file as the Photon-HDF5 that phconvert makes of it.

to_photon_hdf5.py FILE.ptu FILE.h5
"""

import sys

import numpy as np
import phconvert


def convert(source: str, target: str) -> None:
    data, _ = phconvert.loader.loadfile_ptu(source)
    data["description"] = b"a scan"
    data["identity"] = {"author": b"nobody", "author_affiliation": b"nowhere"}
    specs = data["photon_data"]["measurement_specs"]  # what a PTU does not tell, and phconvert asks its user for
    specs["measurement_type"] = "generic"
    specs["detectors_specs"]["spectral_ch1"] = specs["detectors_specs"].pop("spectral_polarization_split_chN")
    data["setup"].update(
        num_spectral_ch=1, num_polarization_ch=1, num_split_ch=1, modulated_excitation=False,
        excitation_cw=np.array([False]), excitation_alternated=np.array([False]),
    )  # fmt: skip
    data["setup"]["detectors"].pop("label")
    phconvert.hdf5.save_photon_hdf5(data, h5_fname=target, close=True)


if __name__ == "__main__":
    convert(*sys.argv[1:])
