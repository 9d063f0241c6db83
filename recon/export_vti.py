"""The volume as VTK image data (.vti), as ParaView and VisIt open it."""

from pathlib import Path

import numpy as np

from nlos.recon.errors import InvalidData
from nlos.recon.volume import Reconstruction


def write_vti(path: Path, reconstruction: Reconstruction) -> None:
    """Writes the albedo volume as appended raw float32: x right, y up, z from the wall, metres.

    Raises `InvalidData` where there is no volume, or its planes are not equally far apart.
    """
    volume = reconstruction.volume
    if volume is None:
        raise InvalidData(f"this {reconstruction.method} reconstruction holds no volume. Make it without --no-volume.")
    depths_m, wall = volume.depths_m, volume.wall
    pitch_m = float(depths_m[1] - depths_m[0]) if len(depths_m) > 1 else 1.0
    if len(depths_m) > 2 and not np.allclose(np.diff(depths_m), pitch_m, rtol=1e-3):
        raise InvalidData("the planes of this volume are not equally far apart, which a .vti cannot say.")
    planes, rows, cols = volume.albedo.shape
    extent = f"0 {cols - 1} 0 {rows - 1} 0 {planes - 1}"
    origin = (float(wall.x_m()[0]), float(wall.y_m()[-1]), float(depths_m[0]))
    spacing = (wall.width_m / wall.cols, wall.height_m / wall.rows, pitch_m)
    values = np.ascontiguousarray(volume.albedo[:, ::-1], dtype="<f4")  # row 0 is the top; a .vti counts y upwards
    header = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<ImageData WholeExtent="{extent}" Origin="{_triple(origin)}" Spacing="{_triple(spacing)}">\n'
        f'<Piece Extent="{extent}"><PointData Scalars="albedo">\n'
        '<DataArray type="Float32" Name="albedo" format="appended" offset="0"/>\n'
        "</PointData></Piece></ImageData>\n"
        '<AppendedData encoding="raw">_'
    )
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(np.uint64(values.nbytes).astype("<u8").tobytes())
        file.write(values.tobytes())
        file.write(b"</AppendedData>\n</VTKFile>\n")


def _triple(values: tuple[float, float, float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
