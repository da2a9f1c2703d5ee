"""A measured BRDF from a file of arrays, as goniometers give it once reduced."""

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from labdata.errors import BadInput
from simulate.radiance.brdf import MeasuredTable

ARRAYS = ("wavelength_nm", "polar_deg", "azimuth_deg", "table")


def read_measured(path: Path) -> MeasuredTable:
    """Return the BRDF of an .npz file with the arrays of `simulate.radiance.brdf.measured.MeasuredTable`.

    Raises
    ------
    BadInput
        If the file cannot be read, lacks an array, or the table is no BRDF.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: np.asarray(file[name], float) for name in ARRAYS if name in file}
    except (OSError, ValueError, EOFError, AttributeError, BadZipFile):
        raise BadInput(f"a measured BRDF must be a readable .npz file, got {path}") from None
    missing = [name for name in ARRAYS if name not in found]
    if missing:
        raise BadInput(f"a measured BRDF must hold {', '.join(ARRAYS)}, got no {missing[0]} in {path.name}")
    try:
        return MeasuredTable(**found)
    except BadInput as error:
        raise BadInput(f"{error}, in {path.name}") from None
