"""Which module registers each method, so that a verb imports only the methods that it may use."""

from importlib import import_module

MODULES: dict[str, dict[str, str]] = {
    "edge": {
        "edge-forward": "charact.mtf.edge.forward",
        "edge-free": "charact.mtf.edge.free",
        "edge-gradient": "charact.mtf.edge.gradient",
        "edge-parametric": "charact.mtf.edge.parametric",
        "edge-slanted": "charact.mtf.edge.slanted",
    },
    "bars": {
        "bars-coltman": "charact.mtf.bars.contrast",
        "bars-contrast": "charact.mtf.bars.contrast",
        "bars-forward": "charact.mtf.bars.forward",
    },
    "point": {
        "point-forward": "charact.mtf.point.forward",
        "point-parametric": "charact.mtf.point.parametric",
        "point-spread": "charact.mtf.point.spot_transform",
    },
    "post-gain": {
        "noise-spectrum": "charact.mtf.noise_spectrum.flats",
        "noise-spectrum-free": "charact.mtf.noise_spectrum.flats",
    },
    "flats": {
        "covariance-sum": "charact.noise.gain.covariance_sum",
        "variance": "charact.noise.gain.variance",
    },
    "bloom": {
        "series-forward": "charact.bloom.series_forward",
    },
    "lit-edge": {"lit-edge": "charact.bloom.lit_edge_halo"},
}
# By kind of target, the quantity by which its methods are charted, and what "auto" takes where no chart was measured.
CHARTED: dict[str, tuple[str, str]] = {
    "edge": ("mtf50", "edge-forward"),
    "bars": ("mtf", "bars-forward"),
    "point": ("mtf50", "point-forward"),
    "post-gain": ("post_gain_mtf50", "noise-spectrum"),
    "flats": ("covariance_gain", "covariance-sum"),
    "bloom": ("halo_diameter", "series-forward"),
    "lit-edge": ("halo_diameter", "lit-edge"),
}


def load(kind: str, name: str | None = None) -> None:
    """Import the modules that register the methods of a kind, or only the method of a name.

    Examples
    --------
    >>> from charact.method import METHODS
    >>> load("edge", "edge-slanted")
    >>> ("edge", "edge-slanted") in METHODS
    True
    """
    for method, module in MODULES.get(kind, {}).items():
        if name in (None, method):
            import_module(module)
