"""Hidden scenes by mitransient (Royo et al. 2022), a renderer that nobody here wrote, with the truth by Mitsuba 3.

`DIR/env/bin/python studies/rendered_by_mitransient.py MESHES OUT [--passes N] [SCENE ...]` runs in an environment of
its own (docs/peers.md) and needs nothing of ours. OUT/SCENE.npz has `transient` (64, 64, 512), of unit maximum, bins of
32 ps from the wall on, and the orthographic front view: `gt_intensity` (albedo times the cosine), `gt_albedo`,
`gt_depth` (m, 0 = nothing) and `gt_mask`, all with row 0 at the top and column 0 at the left as seen from the wall.
"""

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")
from mitransient.integrators.transientnlospath import TransientNLOSPath  # noqa: E402 - needs the variant

SPEED_OF_LIGHT = 299792458.0
POINTS, BINS, BIN_S, HALF_WALL_M = 64, 512, 32e-12, 1.0
FAR, HEIGHT = 40.0, 4.0
"""m: the scanner looks along the wall from afar, so that nothing hidden stands between the two."""
SAMPLES = 1024  # paths a point and pass
FINER = 8  # rays a pixel and axis of the truth

Shape = dict[str, Any]


def seen_only(original: Any) -> Any:
    """Hidden geometry sampling with the test for shadows that mitransient 1.3.1 does without, which lights whatever
    stands behind something."""

    def sample(self: Any, scene: Any, *given: Any) -> Any:
        si, active = given[3], given[-1]
        places = []
        choose = self._sample_hidden_geometry_position

        def chosen(**wanted: Any) -> Any:
            places.append(choose(**wanted))
            return places[-1]

        self._sample_hidden_geometry_position = chosen
        try:
            sampled, weight = original(self, scene, *given)
        finally:
            del self._sample_hidden_geometry_position
        towards = si.p + 0.999 * (places[0].p - si.p)  # short of the surface itself
        return sampled, dr.select(scene.ray_test(si.spawn_ray_to(towards), active), 0.0, weight)

    return sample


def mesh(
    name: str, size: float, at: tuple[float, float, float], yaw: float = 0, pitch: float = 0, bsdf: Shape | None = None
) -> Any:
    """A model turned by degrees, `size` metres along the longer of its width and height, its middle `at`."""

    def make(folder: Path) -> Shape:
        path = str(folder / f"{name}.obj")
        shape = {"type": "obj", "filename": path, "face_normals": True}
        vertices = np.array(mi.traverse(mi.load_dict(shape))["vertex_positions"]).reshape(-1, 3)
        transform = mi.ScalarTransform4f
        turned = transform().rotate([1, 0, 0], pitch) @ transform().rotate([0, 1, 0], yaw)
        there = vertices @ np.array(turned.matrix)[:3, :3].T
        low, high = there.min(0), there.max(0)
        scale = float(size / (high - low)[:2].max())
        shift = [float(place - scale * middle) for place, middle in zip(at, (low + high) / 2, strict=True)]
        placed = transform().translate(shift) @ transform().scale(scale) @ turned
        return {**shape, "to_world": placed, "bsdf": {"type": "twosided", "one": bsdf or diffuse(0.8)}}

    return make


def panel(
    size: tuple[float, float], at: tuple[float, float, float], yaw: float = 0, pitch: float = 0, albedo: float = 0.4
) -> Any:
    """A rectangle that faces the wall; by `yaw` degrees its right edge swings away from it, or its top by `pitch`."""
    yaw, pitch = np.radians(yaw), np.radians(pitch)
    right, up = np.array([np.cos(yaw), 0, np.sin(yaw)]), np.array([0, np.cos(pitch), np.sin(pitch)])
    columns = [-right * size[0] / 2, up * size[1] / 2, -np.cross(right, up), at]
    placed = np.vstack([np.array(columns).T, [0, 0, 0, 1]])
    return lambda _: {"type": "rectangle", "to_world": mi.ScalarTransform4f(placed), "bsdf": diffuse(albedo)}


def ball(radius: float, at: tuple[float, float, float], albedo: float = 0.8) -> Any:
    return lambda _: {"type": "sphere", "center": list(at), "radius": radius, "bsdf": diffuse(albedo)}


def diffuse(albedo: float) -> Shape:
    return {"type": "diffuse", "reflectance": albedo}


GLOSSY: Shape = {"type": "roughplastic", "diffuse_reflectance": 0.8, "alpha": 0.25}

ROOM = {"doll": mesh("cheburashka", 0.9, (-0.2, -0.1, 0.9), 180), "back": panel((1.9, 1.9), (0, 0, 1.6), 8)}
SCENES: Mapping[str, Mapping[str, Any]] = {
    "homer": {"doll": mesh("homer", 1.5, (0, 0, 1.0), 180)},
    "cow": {"cow": mesh("cow", 1.0, (0, 0, 1.0), 60)},
    "suzanne": {"head": mesh("suzanne", 1.3, (0, 0.1, 1.1), 160)},
    "teapot": {"pot": mesh("teapot", 1.4, (0, -0.1, 0.8), 20, -15)},
    "rocker_arm": {"part": mesh("rocker-arm", 1.5, (-0.1, 0, 1.0), 120)},
    "nefertiti": {"bust": mesh("nefertiti", 1.4, (0, 0, 0.9), 0, -90)},
    "fandisk": {"part": mesh("fandisk", 1.1, (0.2, 0, 1.2), 210, 20)},
    "ogre": {"doll": mesh("ogre", 1.4, (0, 0, 1.0), 180)},
    "cow_and_car": {
        "cow": mesh("spot", 0.8, (-0.45, -0.2, 0.8), 200),
        "car": mesh("beetle", 0.9, (0.45, 0.35, 1.4), 60, bsdf=diffuse(0.5)),
    },
    "room": ROOM,
    "room_two_bounces": ROOM,
    "glossy": {"head": mesh("suzanne", 1.3, (0, 0, 1.0), 180, bsdf=GLOSSY)},
    "plain": {  # nothing stands before anything
        "left": panel((0.5, 0.4), (-0.4, 0.3, 0.9), yaw=20, albedo=0.6),
        "low": panel((0.4, 0.5), (-0.3, -0.5, 1.0), pitch=25, albedo=0.8),
        "ball": ball(0.2, (0.4, -0.2, 1.0), albedo=0.7),
    },
}


def shapes(name: str, meshes: Path) -> dict[str, Shape]:
    return {part: {**make(meshes), "id": part} for part, make in SCENES[name].items()}


def rendered(name: str, meshes: Path, points: int, passes: int) -> np.ndarray:
    """transient (points, points, BINS), row 0 at the top, evened out over the wall, maximum 1."""
    bounces = 2 if name.endswith("two_bounces") else 1
    scanner = [-FAR, 0, HEIGHT]
    film: Shape = {
        "type": "transient_hdr_film",
        "rfilter": {"type": "box"},
        "width": points,
        "height": points,
        "temporal_bins": BINS,
        "bin_width_opl": SPEED_OF_LIGHT * BIN_S,
        "start_opl": 0.0,
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "transient_nlos_path",
                "capture_type": "Confocal",
                "nlos_laser_sampling": True,
                "nlos_hidden_geometry_sampling": True,
                "temporal_filter": "box",
                "max_depth": 2 + bounces,  # surfaces that light meets, the wall twice
                "rr_depth": 100,
                "discard_direct_paths": True,
            },
            "wall": {
                "type": "rectangle",
                "bsdf": diffuse(1.0),
                "sensor": {
                    "type": "nlos_capture_meter",
                    "sensor_origin": scanner,
                    "sampler": {"type": "independent", "sample_count": SAMPLES},
                    "film": film,
                },
            },
            "laser": {
                "type": "projector",
                "fov": 0.2,
                "to_world": mi.ScalarTransform4f().look_at(origin=scanner, target=[0, 0, 0], up=[0, 1, 0]),
            },
            **shapes(name, meshes),
        }
    )
    light = np.zeros((points, points, BINS))
    for seed in range(passes):
        light += np.array(mi.render(scene, spp=SAMPLES, seed=seed + 1)[1])[..., 0]
    x, y = places(points)
    laser = ((x + FAR) ** 2 + y**2 + HEIGHT**2) ** -1.5  # 1 / r^2 and the wall's cosine
    light = np.maximum(light[::-1], 0) / laser[..., None]  # the film's first row is the lowest
    even: np.ndarray = light / light.max()
    return even


def places(count: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y of pixels' middles on the wall, row 0 at the top."""
    middles = ((np.arange(count) + 0.5) / count * 2 - 1) * HALF_WALL_M
    x, y = np.meshgrid(middles, -middles)
    return x, y


def truth(name: str, meshes: Path, points: int) -> dict[str, np.ndarray]:
    """The front view along z, by rays of Mitsuba's."""
    scene = mi.load_dict({"type": "scene", **shapes(name, meshes)})
    x, y = (each.ravel() for each in places(points * FINER))
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(mi.Float(x), mi.Float(y), mi.Float(0 * x)), mi.Vector3f(0, 0, 1)))
    found = np.array(hit.is_valid()).astype(bool)
    albedo = np.array(hit.bsdf().eval_diffuse_reflectance(hit, hit.is_valid())).ravel()
    cosine = np.abs(np.array(hit.n)[2])

    def by_pixel(values: np.ndarray, elsewhere: float) -> np.ndarray:
        tiles = np.where(found, values, elsewhere).reshape(points, FINER, points, FINER)
        return tiles.transpose(0, 2, 1, 3).reshape(points, points, -1)

    covered = by_pixel(np.ones_like(albedo), 0).mean(-1)
    mask = covered >= 0.5
    depth = by_pixel(np.array(hit.t), np.nan)
    depth_m = np.zeros((points, points))
    depth_m[mask] = np.nanmedian(depth[mask], axis=-1)
    return {
        "gt_intensity": by_pixel(albedo * cosine, 0).mean(-1),
        "gt_albedo": by_pixel(albedo, 0).mean(-1) / np.maximum(covered, 1e-9),
        "gt_depth": depth_m,
        "gt_mask": mask,
    }


def main() -> None:
    command = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    command.add_argument("meshes", type=Path)
    command.add_argument("out", type=Path)
    command.add_argument("scenes", nargs="*", help=f"of {', '.join(SCENES)}; all but plain")
    command.add_argument("--passes", type=int, default=16, help=f"of {SAMPLES} paths a point")
    command.add_argument("--points", type=int, default=POINTS, help="a side")
    given = command.parse_args()
    TransientNLOSPath.hidden_geometry_sample = seen_only(TransientNLOSPath.hidden_geometry_sample)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.scenes or [name for name in SCENES if name != "plain"]:
        began = time.monotonic()
        light = rendered(name, given.meshes, given.points, given.passes)
        arrays: dict[str, Any] = {"transient": light, **truth(name, given.meshes, given.points)}
        np.savez_compressed(given.out / name, **{key: each.astype(np.float32) for key, each in arrays.items()})
        print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
