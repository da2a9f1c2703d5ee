"""A scene of ours written down for a path tracer: meshes as PLY files, the sky as a table, the rest
as JSON.
"""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.radiance.scenes import Case
from simulate.radiance.lamps.distribution import Cosine, Distribution, Isotropic, Lamp, SpotBeam
from simulate.radiance.outdoor.scene import LampPlacement

# Rows and columns of the sky's table: finer than ours, so that the path tracer's own interpolation
# adds nothing.
SKY_SHAPE = (2048, 720)


def export(case: Case, folder: Path) -> None:
    """Write a scene into a folder of its name."""
    into = folder / case.name
    into.mkdir(parents=True, exist_ok=True)
    view, dome = case.view, case.stage.lighting.environment_map
    told = {
        "shape": view.shape,
        "field_deg": float(2.0 * np.rad2deg(np.arctan(0.5 * view.shape[1] / view.focal_px[0]))),
        "position_m": [float(x) for x in view.position_m],
        "target_m": [float(x) for x in np.add(view.position_m, view.forward)],
        "max_depth": -1 if case.max_bounces is None else case.max_bounces + 2,
        "meshes": _meshes(case, into),
        "lamps": [
            _lamp(post, lamp, float(light.spectrum[0]))
            for (post, lamp), light in zip(case.site.lamps, case.stage.lighting.lamps, strict=True)
        ],
        "even_sky": case.even_sky,
    }
    (into / "scene.json").write_text(json.dumps(told))
    if not dome.is_dark and case.even_sky is None:
        np.save(into / "sky.npy", dome.radiance(_sky_directions())[:, 0].reshape(SKY_SHAPE))


def _meshes(case: Case, into: Path) -> list[dict]:
    import trimesh
    from trimesh.exchange.ply import export_ply

    surfaces, panels = case.stage.surfaces, case.stage.lighting.panels
    told = []
    for number, name in enumerate(surfaces.materials):
        which = np.flatnonzero(surfaces.material_of == number)
        mesh = trimesh.Trimesh(surfaces.mesh.vertices_m, surfaces.mesh.faces[which], process=False)
        mesh.remove_unreferenced_vertices()
        (into / f"{number}.ply").write_bytes(export_ply(mesh, vertex_normal=False))
        kind = -1 if panels is None else int(panels.kind_of_face[which[0]])
        told.append(
            {
                "name": name,
                "file": f"{number}.ply",
                "reflectance": float(case.stage.bsdfs.rho_by_pi[number, 0] * np.pi),
                "radiance": 0.0 if panels is None or kind < 0 else float(panels.spectra[kind, 0]),
            }
        )
    return told


def _lamp(post: LampPlacement, lamp: Lamp, flux: float) -> dict:
    """A lamp's peak intensity and its power of the cosine; None where it shines alike
    everywhere.
    """
    axis = (
        np.array([0.0, 0.0, -1.0])
        if post.aim_m is None
        else np.subtract(post.aim_m, post.position_m)
    )
    power = _power(lamp.distribution)
    peak = flux / (4.0 * np.pi) if power is None else flux * (power + 1.0) / (2.0 * np.pi)
    return {
        "position_m": [float(x) for x in post.position_m],
        "axis": (axis / np.linalg.norm(axis)).tolist(),
        "peak": peak,
        "power": power,
    }


def _power(distribution: Distribution) -> float | None:
    match distribution:
        case Isotropic():
            return None
        case Cosine():
            return 1.0
        case SpotBeam():
            return distribution.power
    raise ValueError(
        f"a path tracer is told of even, cosine and spot lamps only, got {distribution}"
    )


def _sky_directions() -> NDArray[np.float64]:
    """Directions of the middles of the sky table's cells: rows from zenith to nadir, columns from
    north by east.
    """
    rows, columns = SKY_SHAPE
    tilt = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    tilt, turn = np.meshgrid(tilt, turn, indexing="ij")
    return np.stack(
        [np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)], axis=-1
    ).reshape(-1, 3)
