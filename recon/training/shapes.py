"""Simple bodies drawn into an orthographic front view with a z-buffer: tubes, boxes, quadrics, turned bodies, planes.

Coordinates are in half-widths of the wall: x right, y up, z from the wall towards the scene; rays run along +z.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Vector = tuple[float, float, float]
STEEPEST = 0.15
"""Share of a surface that its pixel's area is taken to show at least: nearly edge-on, it would count without end."""
THIN = 2.0
"""Rods of a smaller radius, in pixels, are drawn without a rear: they are all outline."""
BACKWARDS = np.array([1, 1, -1], np.float32)[:, None, None]


@dataclass(frozen=True)
class Body:
    """What was drawn, with what the front view does not show of it: (m, n) is a window of the canvas."""

    at: tuple[slice, slice]
    front: Array  # (m, n) depth, +inf where it is not
    rear: Array  # (m, n) depth where it ends; as `front` for sheets
    front_normal: Array | None  # (3, m, n); None where another surface stands for it
    rear_normal: Array | None  # (3, m, n); None for sheets, and where `sides` stand for it
    albedo: Array | float
    coverage: Array | float = 1.0
    sides: Array | None = None  # (K, 7): place, normal, area


@dataclass(frozen=True)
class Canvas:
    """The front view under construction: whatever is nearest to the wall wins. All arrays are filled in place."""

    x: Array  # (N,) pixel centres, left to right
    y: Array  # (M,) pixel centres, top to bottom
    depth: Array  # (M, N), +inf where nothing is
    normal: Array  # (3, M, N), towards the wall
    albedo: Array  # (M, N)
    coverage: Array  # (M, N), part of the pixel that is covered
    bodies: list[Body] = field(default_factory=list)

    @property
    def pitch(self) -> float:
        return float(self.x[1] - self.x[0])


def blank_canvas(rows: int, cols: int, aspect: float = 1.0) -> Canvas:
    """An empty view of `rows` x `cols` pixels over [-aspect, aspect] x [-1, 1]."""
    return Canvas(
        x=(((np.arange(cols) + 0.5) / cols * 2 - 1) * aspect).astype(np.float32),
        y=(1 - (np.arange(rows) + 0.5) / rows * 2).astype(np.float32),
        depth=np.full((rows, cols), np.inf, np.float32),
        normal=np.zeros((3, rows, cols), np.float32),
        albedo=np.zeros((rows, cols), np.float32),
        coverage=np.zeros((rows, cols), np.float32),
    )


def window(canvas: Canvas, x0: float, x1: float, y0: float, y1: float) -> tuple[slice, slice] | None:
    """Rows and columns whose pixels lie within the box, or None."""
    left, right = np.searchsorted(canvas.x, (x0, x1))
    top, bottom = np.searchsorted(-canvas.y, (-y1, -y0))
    if left >= right or top >= bottom:
        return None
    return slice(int(top), int(bottom)), slice(int(left), int(right))


def put(
    canvas: Canvas,
    at: tuple[slice, slice],
    depth: Array,
    normal: Array,
    albedo: Array | float,
    coverage: Array | float = 1.0,
) -> None:
    """Draw `depth` (inf = transparent) and its unit normals (3, ...) into a window of the canvas."""
    nearer = depth < canvas.depth[at]
    canvas.depth[at][nearer] = depth[nearer]
    canvas.normal[(slice(None), *at)][:, nearer] = normal[:, nearer]
    for target, value in ((canvas.albedo, albedo), (canvas.coverage, coverage)):
        target[at][nearer] = value[nearer] if isinstance(value, np.ndarray) else value


def tube(canvas: Canvas, a: Vector, b: Vector, radius_a: float, radius_b: float, albedo: float) -> None:
    """A round, possibly tapered rod with round ends from `a` to `b`; thinner than a pixel it covers part of it."""
    reach = max(radius_a, radius_b, canvas.pitch)
    at = window(
        canvas,
        min(a[0], b[0]) - reach,
        max(a[0], b[0]) + reach,
        min(a[1], b[1]) - reach,
        max(a[1], b[1]) + reach,
    )
    if at is None:
        return
    x, y = canvas.x[at[1]][None, :], canvas.y[at[0]][:, None]
    along = (b[0] - a[0], b[1] - a[1])
    squared = along[0] ** 2 + along[1] ** 2
    if squared > 1e-9:
        t = np.clip(((x - a[0]) * along[0] + (y - a[1]) * along[1]) / squared, 0, 1)
    else:
        t = np.full((y.size, x.size), 0.0 if a[2] < b[2] else 1.0, np.float32)
    dx, dy = x - (a[0] + t * along[0]), y - (a[1] + t * along[1])
    radius = radius_a + t * (radius_b - radius_a)
    centre = a[2] + t * (b[2] - a[2])
    distance = np.sqrt(dx * dx + dy * dy)
    drawn = np.maximum(radius, 0.5 * canvas.pitch)  # a thin wire is drawn one pixel wide, at its true share of it
    inside = distance < drawn
    bulge = np.sqrt(np.maximum(1 - (distance / drawn) ** 2, 0.0))
    depth = np.where(inside, centre - radius * bulge, np.inf).astype(np.float32)
    normal = np.stack((dx / drawn, dy / drawn, -np.maximum(bulge, 0.1)))
    normal /= np.linalg.norm(normal, axis=0)
    normal, covered = normal.astype(np.float32), (radius / drawn).astype(np.float32)
    put(canvas, at, depth, normal, albedo, covered)
    if min(radius_a, radius_b) > THIN * canvas.pitch:
        rear = (2 * centre - depth).astype(np.float32)
        canvas.bodies.append(Body(at, depth, rear, normal, normal * BACKWARDS, albedo, covered))


def polyline(canvas: Canvas, points: npt.NDArray[np.float64], radius: float, albedo: float) -> None:
    """A tube through `points` (K, 3)."""
    for a, b in pairwise(points):
        tube(canvas, (a[0], a[1], a[2]), (b[0], b[1], b[2]), radius, radius, albedo)


def box(canvas: Canvas, centre: Vector, half: Vector, rotation: npt.NDArray[np.float64], albedo: float) -> None:
    """A box with half sides `half`, its axes the columns of `rotation` (3, 3)."""
    extent = np.abs(rotation) @ np.asarray(half)
    at = window(canvas, centre[0] - extent[0], centre[0] + extent[0], centre[1] - extent[1], centre[1] + extent[1])
    if at is None:
        return
    x, y = canvas.x[at[1]][None, :] - centre[0], canvas.y[at[0]][:, None] - centre[1]
    near = np.full((y.size, x.size), -np.inf, np.float32)
    far = np.full((y.size, x.size), np.inf, np.float32)
    normal = np.zeros((3, y.size, x.size), np.float32)
    for axis in range(3):
        direction = rotation[:, axis]
        offset = (x * direction[0] + y * direction[1]).astype(np.float32)
        slope = direction[2]
        if abs(slope) < 1e-6:
            far = np.where(np.abs(offset) > half[axis], np.float32(-np.inf), far)
            continue
        enter = ((-half[axis] * np.sign(slope) - offset) / slope).astype(np.float32)
        leave = ((half[axis] * np.sign(slope) - offset) / slope).astype(np.float32)
        later = enter > near
        near, far = np.where(later, enter, near), np.minimum(far, leave)
        normal[:, later] = (-np.sign(slope) * direction).astype(np.float32)[:, None]
    depth = np.where(near < far, near + centre[2], np.inf).astype(np.float32)
    put(canvas, at, depth, normal, albedo)
    rear = np.where(near < far, far + centre[2], np.inf).astype(np.float32)
    sides = _sides(canvas.pitch, centre, half, rotation)
    canvas.bodies.append(Body(at, depth, rear, normal, None, albedo, 1.0, sides))


def _sides(pitch: float, centre: Vector, half: Vector, rotation: npt.NDArray[np.float64]) -> Array:
    """Pieces (K, 7) of the faces of a box that the front view does not show, two pixels wide."""
    pieces = []
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        counts = [max(1, round(half[other] / pitch)) for other in across]
        steps = [((np.arange(n) + 0.5) / n * 2 - 1) * half[other] for n, other in zip(counts, across, strict=True)]
        along = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2) @ rotation[:, across].T
        area = 4 * half[across[0]] * half[across[1]] / len(along)
        for outward in (-1.0, 1.0):
            normal = outward * rotation[:, axis]
            if normal[2] > -1e-3:
                place = along + np.asarray(centre) + half[axis] * normal
                pieces.append(np.hstack((place, np.tile([*normal, area], (len(along), 1)))))
    return np.concatenate(pieces).astype(np.float32)


def ellipsoid(canvas: Canvas, centre: Vector, half: Vector, rotation: npt.NDArray[np.float64], albedo: float) -> None:
    """An ellipsoid with half axes `half` along the columns of `rotation` (3, 3)."""
    metric = rotation @ np.diag(1 / np.square(half)) @ rotation.T
    reach = np.sqrt(np.diag(np.linalg.inv(metric)))
    at = window(canvas, centre[0] - reach[0], centre[0] + reach[0], centre[1] - reach[1], centre[1] + reach[1])
    if at is None:
        return
    x, y = canvas.x[at[1]][None, :] - centre[0], canvas.y[at[0]][:, None] - centre[1]
    linear = metric[0, 2] * x + metric[1, 2] * y
    constant = metric[0, 0] * x * x + 2 * metric[0, 1] * x * y + metric[1, 1] * y * y - 1
    root = linear**2 - metric[2, 2] * constant
    faces = []
    for towards in (-1, 1):
        z = ((-linear + towards * np.sqrt(np.maximum(root, 0))) / metric[2, 2]).astype(np.float32)
        place = np.stack((np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z))
        normal = np.einsum("ij,jrc->irc", metric, place).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=0) + 1e-9
        faces.append((np.where(root > 0, z + centre[2], np.inf).astype(np.float32), normal))
    (front, normal), (rear, rear_normal) = faces
    put(canvas, at, front, normal, albedo)
    canvas.bodies.append(Body(at, front, rear, normal, rear_normal, albedo))


@dataclass(frozen=True)
class Turned:
    """A body of revolution: radii `profile` (K,) along an axis of `length`, turned by `angle_rad` in the view plane.

    `lean` is dz/d(axis), a shear: the axis points away from the wall without leaving the closed form.
    """

    profile: npt.NDArray[np.float64]
    length: float
    angle_rad: float
    lean: float


def turned(canvas: Canvas, centre: Vector, body: Turned, albedo: float) -> None:
    """Draws a body of revolution."""
    profile, length, angle_rad, lean = body.profile, body.length, body.angle_rad, body.lean
    reach = float(np.hypot(length / 2, profile.max()))
    at = window(canvas, centre[0] - reach, centre[0] + reach, centre[1] - reach, centre[1] + reach)
    if at is None:
        return
    x, y = canvas.x[at[1]][None, :] - centre[0], canvas.y[at[0]][:, None] - centre[1]
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    across, along = x * cos + y * sin, -x * sin + y * cos
    knots = np.linspace(-length / 2, length / 2, profile.size)
    radius = np.interp(along, knots, profile, left=0.0, right=0.0)
    slope = np.interp(along, knots, np.gradient(profile, knots))
    root = radius**2 - across**2
    bulge = np.sqrt(np.maximum(root, 0))
    depth = np.where(root > 0, centre[2] + lean * along - bulge, np.inf).astype(np.float32)
    d_along = lean - radius * slope / np.maximum(bulge, 0.1 * radius + 1e-6)
    d_across = across / np.maximum(bulge, 0.1 * radius + 1e-6)
    normal = normals_of_slopes(d_across * cos - d_along * sin, d_across * sin + d_along * cos)
    put(canvas, at, depth, normal, albedo)
    rear = np.where(root > 0, centre[2] + lean * along + bulge, np.inf).astype(np.float32)
    d_across, d_along = -d_across, 2 * lean - d_along
    rear_normal = -normals_of_slopes(d_across * cos - d_along * sin, d_across * sin + d_along * cos)
    canvas.bodies.append(Body(at, depth, rear, normal, rear_normal, albedo))


def normals_of_slopes(dz_dx: npt.NDArray[np.floating], dz_dy: npt.NDArray[np.floating]) -> Array:
    """Unit normals towards the wall of a surface z(x, y), shape (3, ...)."""
    normal = np.stack(np.broadcast_arrays(dz_dx, dz_dy, -1.0))
    return np.asarray(normal / np.sqrt(dz_dx**2 + dz_dy**2 + 1), dtype=np.float32)


def panel(
    canvas: Canvas, coverage: Array, centre_depth: float, slope: tuple[float, float], albedo: Array | float
) -> None:
    """A flat sheet over the whole canvas, z = depth + slope . (x, y), present where `coverage` (M, N) is above 0."""
    depth = centre_depth + slope[0] * canvas.x[None, :] + slope[1] * canvas.y[:, None]
    normal = normals_of_slopes(np.full_like(depth, slope[0]), np.full_like(depth, slope[1]))
    whole = (slice(0, canvas.y.size), slice(0, canvas.x.size))
    depth = np.where(coverage > 0.05, depth, np.inf).astype(np.float32)
    put(canvas, whole, depth, normal, albedo, coverage)
    canvas.bodies.append(Body(whole, depth, depth, normal, None, albedo, coverage))


def height_field(canvas: Canvas, depth: Array, albedo: Array | float) -> None:
    """A surface z(x, y) given on the whole canvas, inf where it is not; normals by differences."""
    present = np.isfinite(depth)
    filled = np.where(present, depth, np.float32(depth[present].max() if present.any() else 1.0))
    dz_dy, dz_dx = np.gradient(filled, -canvas.pitch, canvas.pitch)
    inner = present.copy()
    inner[1:] &= present[:-1]
    inner[:-1] &= present[1:]
    inner[:, 1:] &= present[:, :-1]
    inner[:, :-1] &= present[:, 1:]
    # Across an outline the difference is a step, not a slope: take the surface there as facing half away.
    steep = np.where(inner, 1.0, 1.0 / np.maximum(np.hypot(dz_dx, dz_dy), 1.0))
    whole = (slice(0, canvas.y.size), slice(0, canvas.x.size))
    put(canvas, whole, depth, normals_of_slopes(dz_dx * steep, dz_dy * steep), albedo)


def rotation_matrix(yaw_rad: float, pitch_rad: float, roll_rad: float) -> npt.NDArray[np.float64]:
    """Turned about y (yaw), then x (pitch), then z (roll)."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw_rad, pitch_rad, roll_rad) for f in (np.cos, np.sin))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_x @ about_y, dtype=np.float64)
