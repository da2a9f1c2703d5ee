"""A camera without fixed patterns and with a fine digitiser, so that its noise can be held against
formulas.
"""

from collections.abc import Callable
from dataclasses import replace

import pytest

from labdata import Camera, load_sensor

# No fixed pattern, no rare event, no saturation, steps of the digitiser far below the noise.
PLAIN = {
    "ccd.prnu": 0.0,
    "ccd.dsnu_e": 0.0,
    "ccd.smear_fraction": 0.0,
    "ccd.full_well_e": 3e5,
    "phosphor.gain_nonuniformity": 0.0,
    "taper.pattern_contrast": 0.0,
    "microchannel_plate.pattern_contrast": 0.0,
    "microchannel_plate.ion_event_rate_per_s_cm2": 0.0,
    "microchannel_plate.strip_current_ua_per_cm2": 1e9,
    "optics.veiling_glare_fraction": 0.0,
    "video.conversion_gain_dn_per_e": 0.2,
    "video.black_level_dn": 400.0,
    "video.sync_jitter_ns": 0.0,
    "video.line_noise_dn": 0.0,
}


@pytest.fixture(scope="session")
def sheet() -> Camera:
    """The case-study camera as shipped."""
    return load_sensor("pulnix-ag5745ef3")


@pytest.fixture(scope="session")
def plain(sheet: Camera) -> Callable[..., Camera]:
    """Make a small plain camera of so many rows and columns, with some values changed by path."""

    def make(rows: int, columns: int, **changes: float) -> Camera:
        small = replace(
            sheet,
            ccd=replace(sheet.ccd, rows=rows, columns=columns),
            video=replace(sheet.video, bit_depth=16),
        )
        return small.with_values(
            PLAIN | {path.replace("__", "."): value for path, value in changes.items()}
        )

    return make
