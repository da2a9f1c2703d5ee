"""Pictures by Mitsuba 3, in an environment of its own, asked for line by line; `make study
NAME=radiance-peers` sets it up.

Called with a folder of scenes as `benchmarks.radiance.export` writes them. Each line of input is a
JSON object with `scene`, `samples`, `seed` and `path`; the picture goes to that path (.npy), and a
line with `seconds` and `core_seconds` answers. `lights` chooses "all", "sky" or "lamps", `by`
Mitsuba's integrator ("path" or "ptracer"), and `depth` how far it goes instead of as far as the
scene says.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import drjit
import mitsuba
import numpy as np

THREADS = 2
# Samples of a pixel in one pass: memory.
PASS = 256


def define_beam() -> None:
    """Teach Mitsuba a point that shines by a power of the cosine from its axis."""

    class Beam(mitsuba.Emitter):
        def __init__(self, props: mitsuba.Properties) -> None:
            super().__init__(props)
            self.place = mitsuba.Point3f(props["place"])
            self.axis = mitsuba.Vector3f(props["axis"])
            self.peak, self.power = props["peak"], props["power"]
            self.m_flags = mitsuba.EmitterFlags.DeltaPosition

        def sample_direction(self, it, sample, active=True):
            found = mitsuba.DirectionSample3f()
            way = self.place - it.p
            square = drjit.squared_norm(way)
            found.p, found.n, found.uv = self.place, mitsuba.Normal3f(0), mitsuba.Point2f(0)
            found.time, found.pdf, found.delta = it.time, 1.0, True
            found.emitter = mitsuba.EmitterPtr(self)
            found.dist = drjit.sqrt(square)
            found.d = way / found.dist
            cosine = drjit.maximum(drjit.dot(-found.d, self.axis), 0.0)
            return found, mitsuba.Spectrum(
                self.peak * drjit.power(cosine, self.power) / square
            ) & active

        def pdf_direction(self, it, ds, active=True):
            return mitsuba.Float(0.0)

        def eval_direction(self, it, ds, active=True):
            return mitsuba.Spectrum(0.0)

        def eval(self, si, active=True):
            return mitsuba.Spectrum(0.0)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            cosine = drjit.power(1.0 - sample2.x, 1.0 / (self.power + 1.0))
            flat = drjit.sqrt(drjit.maximum(1.0 - cosine * cosine, 0.0))
            sine, around = drjit.sincos(2.0 * drjit.pi * sample2.y)
            towards = mitsuba.Frame3f(self.axis).to_world(
                mitsuba.Vector3f(flat * around, flat * sine, cosine)
            )
            ray = mitsuba.Ray3f(self.place, towards, time, mitsuba.Color0f())
            return ray, mitsuba.Spectrum(self.peak * 2.0 * drjit.pi / (self.power + 1.0)) & active

        def sample_position(self, time, sample, active=True):
            found = mitsuba.PositionSample3f()
            found.p, found.n, found.uv = self.place, mitsuba.Normal3f(0), mitsuba.Point2f(0)
            found.time, found.pdf, found.delta = time, 1.0, True
            return found, mitsuba.Float(1.0)

        def sample_wavelengths(self, si, sample, active=True):
            return mitsuba.Color0f(), mitsuba.Spectrum(1.0)

        def bbox(self):
            return mitsuba.ScalarBoundingBox3f(mitsuba.ScalarPoint3f(0))

        def to_string(self):
            return "Beam[]"

    mitsuba.register_emitter("beam", Beam)


def scene_of(folder: Path, lights: str) -> mitsuba.Scene:
    """Return a scene as Mitsuba has it, with "all" of its lights, the "sky" alone or the "lamps"
    alone.
    """
    told = json.loads((folder / "scene.json").read_text())
    parts = {"type": "scene", "sensor": sensor_of(told)}
    parts |= {f"mesh {number}": mesh_of(folder, mesh) for number, mesh in enumerate(told["meshes"])}
    if lights != "sky":
        parts |= {f"lamp {number}": lamp_of(lamp) for number, lamp in enumerate(told["lamps"])}
    if lights != "lamps":
        parts |= sky_of(folder, told["even_sky"])
    return mitsuba.load_dict(parts)


def sensor_of(told: dict) -> dict:
    """Return the pinhole camera of a scene, every pixel an even mean over its square."""
    rows, columns = told["shape"]
    place = mitsuba.ScalarTransform4f().look_at(
        origin=told["position_m"], target=told["target_m"], up=[0, 0, 1]
    )
    return {
        "type": "perspective",
        "fov": told["field_deg"],
        "fov_axis": "x",
        "near_clip": 1e-3,
        "far_clip": 1e5,
        "to_world": place,
        "film": {
            "type": "hdrfilm",
            "width": columns,
            "height": rows,
            "rfilter": {"type": "box"},
            "pixel_format": "luminance",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter", "sample_count": 64},
    }


def mesh_of(folder: Path, mesh: dict) -> dict:
    """Return a matt surface, which may shine."""
    matt = {"type": "diffuse", "reflectance": constant(mesh["reflectance"])}
    shape = {
        "type": "ply",
        "filename": str(folder / mesh["file"]),
        "face_normals": True,
        "bsdf": {"type": "twosided", "inside": matt},
    }
    if mesh["radiance"]:
        shape["emitter"] = {"type": "area", "radiance": constant(mesh["radiance"])}
    return shape


def lamp_of(lamp: dict) -> dict:
    """Return a point that shines evenly, or as a beam."""
    if lamp["power"] is None:
        return {
            "type": "point",
            "position": lamp["position_m"],
            "intensity": constant(lamp["peak"]),
        }
    return {
        "type": "beam",
        "place": mitsuba.ScalarPoint3f(lamp["position_m"]),
        "axis": mitsuba.ScalarVector3f(lamp["axis"]),
        "peak": lamp["peak"],
        "power": lamp["power"],
    }


def sky_of(folder: Path, even_sky: float | None) -> dict:
    """Return the sky, even or as its table has it, by its name; nothing where there is none."""
    if even_sky is not None:
        return {"sky": {"type": "constant", "radiance": constant(even_sky)}}
    if not (folder / "sky.npy").exists():
        return {}
    table = np.load(folder / "sky.npy").astype(np.float32)[..., None]
    upright = mitsuba.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"sky": {"type": "envmap", "bitmap": mitsuba.Bitmap(table), "to_world": upright}}


def constant(value: float) -> dict:
    """Return a spectrum that is the same everywhere."""
    return {"type": "spectrum", "value": value}


def rendered(
    scene: mitsuba.Scene, integrator: mitsuba.Integrator, samples: int, seed: int
) -> np.ndarray:
    """Return a picture, in passes where there are many samples."""
    passes = max(1, samples // PASS)
    total = None
    for number in range(passes):
        made = mitsuba.render(
            scene, integrator=integrator, spp=samples // passes, seed=seed * 4096 + number
        )
        image = np.array(made, np.float64)[..., 0]
        total = image if total is None else total + image
    assert total is not None
    return total / passes


def main() -> None:
    """Answer line by line."""
    variant = sys.argv[2] if len(sys.argv) > 2 else "llvm_ad_mono"
    mitsuba.set_variant(variant)
    drjit.set_thread_count(THREADS)
    define_beam()
    scenes: dict[tuple[str, str], mitsuba.Scene] = {}
    print(json.dumps({"mitsuba": mitsuba.__version__, "variant": variant}), flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        folder, lights = Path(sys.argv[1]) / asked["scene"], asked.get("lights", "all")
        kept = (asked["scene"], lights)
        if kept not in scenes:
            scenes[kept] = scene_of(folder, lights)
        depth = asked.get("depth", json.loads((folder / "scene.json").read_text())["max_depth"])
        integrator = mitsuba.load_dict({"type": asked.get("by", "path"), "max_depth": depth})
        start, used = time.perf_counter(), time.process_time()
        image = rendered(scenes[kept], integrator, asked["samples"], asked["seed"])
        told = {"seconds": time.perf_counter() - start, "core_seconds": time.process_time() - used}
        np.save(asked["path"], image)
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
