"""Our methods: module, quantities and scope, readable without an import of the methods."""

from typing import NamedTuple


class Description(NamedTuple):
    """Module that registers a method, measured quantities (the first is the charted one), and range
    of validity.
    """

    module: str
    quantities: tuple[str, ...]
    scope: str


# By kind of target and name of the method.
DESCRIPTIONS: dict[str, dict[str, Description]] = {
    "edge": {
        "edge-forward": Description(
            "charact.estimators.mtf.edge.parametric",
            ("mtf50", "mtf10", "mtf", "edge_angle"),
            "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard "
            "deviation of the pixel noise, 30 rows and more; noise may depend on the signal and "
            "be correlated. Broken by motion between fields, clipping, windows narrower than the "
            "blur, and a curved response: on a Gaussian edge of high contrast a gamma of 0.45 to "
            "2.2 moves MTF50 by -3 to +15 % and is detected only from tails or the plateaus' "
            "noise; at low contrast it does no harm.",
        ),
        "edge-free": Description(
            "charact.estimators.mtf.edge.free",
            ("mtf50", "mtf10", "mtf", "edge_angle"),
            "Straight or gently bent edges tilted 1 to 45 degrees in any direction, and rims of "
            "discs, step over 5 standard deviations of the pixel noise, 60 rows and more, a line "
            "spread of any smooth shape, symmetric or not, that ends inside the region. A curved "
            "response that the noise leaves possible widens its interval. Normalises to the light "
            "inside the region: what tails and halo carry beyond it is not seen. Noise costs it up "
            "to half as much again as a method that knows the form.",
        ),
        "edge-gradient": Description(
            "charact.estimators.mtf.edge.conventional",
            ("mtf50", "mtf10", "mtf", "edge_angle"),
            "Straight edges tilted 3 to 15 degrees, 60 rows and more, step over 20 standard "
            "deviations of the noise, even light. Normalises to the light inside the region; "
            "uneven light and noise bias it, and a curved response mostly unseen (a gamma of 0.45 "
            "to 2.2: up to 16 %).",
        ),
        "edge-parametric": Description(
            "charact.estimators.mtf.edge.parametric",
            ("mtf50", "mtf10", "mtf", "edge_angle"),
            "Straight edges tilted 1 to 45 degrees in any direction, step over 1 standard "
            "deviation of the pixel noise, 30 rows and more, blurred as lenses and tubes blur: "
            "Gaussian, exp(-(f/fc)^n) or Moffat, with halo or glare; noise may depend on the "
            "signal and be correlated. Any other blur is flagged where the data show it; a curved "
            "response, motion between fields, clipping and windows narrower than the blur break "
            "it.",
        ),
        "edge-slanted": Description(
            "charact.estimators.mtf.edge.conventional",
            ("mtf50", "mtf10", "mtf", "edge_angle"),
            "Straight edges tilted 3 to 15 degrees, 60 rows and more, step over 20 standard "
            "deviations of the noise, even light. Normalises to the light inside the window; "
            "uneven light, noise, halo and short edges bias it, and a curved response mostly "
            "unseen (a gamma of 0.45 to 2.2: -7 to +17 %).",
        ),
    },
    "bars": {
        "bars-forward": Description(
            "charact.estimators.mtf.bars.forward",
            ("mtf",),
            "Two to sixty bars, as wide as their gaps within a few percent, brighter or darker "
            "than a uniform background, in any direction, completely inside the region with "
            "their blur, or crossing it within 12 degrees of an axis; fundamental over 5 "
            "standard uncertainties. Number and frequency are measured from three bars on if not "
            "stated. Without a sensor "
            "description the blur is modelled as a tube, a lens in or out of focus, a Moffat, two "
            "Gaussians or one in a scatter tail, of another width along the bars than across. "
            "Invalid with clipping and motion between fields (undetectable for bars along rows). "
            "A nonlinear response is detected in the image and in noise that does not grow as the "
            "light; the interval includes undetected nonlinearity. Sharpening is flagged where a "
            "step would overshoot by 2.5 %. Untilted bars near the sampling limit are refused; one "
            "bar more or fewer than stated is flagged where detectable.",
        ),
    },
    "point": {
        "point-forward": Description(
            "charact.estimators.mtf.point.forward",
            ("mtf50", "mtf10"),
            "Single point sources of an intensifier or of an ordinary camera, light over 6 "
            "standard uncertainties; neighbours at least 5 px away; MTF50 below 0.42 cycles per "
            "pixel. With a sensor description the blur is that of the described tube, halo and "
            "video filter within their ranges; without one it is a Gaussian or exp(-(f/fc)^n) "
            "with or without a Gaussian, and a halo is not assumed: one that the pixels show is "
            "flagged. Pixels at full scale are treated as lower limits; with a sensor description "
            "the result is then suspect. Not detected: a second source within the blur, and a "
            "nonlinear response that the noise does not show (a gamma of g changes MTF50 by about "
            "the root of g).",
        ),
        "point-parametric": Description(
            "charact.estimators.mtf.point.parametric",
            ("mtf50", "mtf10", "mtf"),
            "Single point sources or pinholes of known, bounded or zero size, light over 6 "
            "standard uncertainties, one frame or more, blur of lenses and tubes: Gaussian, "
            "exp(-(f/fc)^n), Moffat, diffraction with or without central obscuration and defocus, "
            "round or elliptical with an aspect up to 1.5, with halo, disc or scatter inside the "
            "region, neighbours at least 5 px away; MTF50 below 0.42 cycles per pixel. Wide spots "
            "are fitted in squares of pixels. Pixels at full scale are treated as lower limits; "
            "with a sensor description, whose wells may fill first and whose filter spreads "
            "clipped light, the result is suspect. Two sources in one spot are refused from 0.7 "
            "full widths apart on; forms that leave the transform of the light itself are "
            "rejected. Not detected: a closer second source, a pinhole of unstated size, and a "
            "nonlinear response that the noise does not show: a gamma of g changes MTF50 by about "
            "the root of g, and more with a halo.",
        ),
        "point-spread": Description(
            "charact.estimators.mtf.point.spot_transform",
            ("mtf50", "mtf10"),
            "Single unsaturated point sources of any form, one frame or more (three of a tube), "
            "with background around them inside the region: light beyond is that of wings that "
            "fall as r^-3, whose uncertainty the interval holds. Linear response: a gamma between "
            "0.6 and 2.2 is not detected, nor are halos below the noise and a second source within "
            "0.7 full widths. What the MTF beyond half a cycle per pixel folds back is in the "
            "interval.",
        ),
    },
    "post-gain": {
        "noise-spectrum": Description(
            "charact.estimators.mtf.noise_spectrum.flats",
            ("post_gain_mtf50", "post_gain_mtf", "white_noise_fraction"),
            "Darks and flats of two levels and more, 4 frames each, some 100 x 100 px, of a "
            "camera that blurs after its gain to f2 = 0.08 to 0.4 cy/px; light scattered after "
            "the gain beyond that blur is not counted: a note says how much of it would not show. "
            "A curved response shows where levels of more than a photoelectron a pixel differ.",
        ),
        "noise-spectrum-free": Description(
            "charact.estimators.mtf.noise_spectrum.flats",
            ("post_gain_mtf50", "post_gain_mtf", "white_noise_fraction"),
            "As noise-spectrum, for blur of any smooth falling form; intervals are wider.",
        ),
    },
    "flats": {
        "covariance-sum": Description(
            "charact.estimators.noise.covariance_sum",
            ("covariance_gain", "blur_factor", "read_noise", "photoelectron_gain"),
            "Flats and darks of at least two frames, intensified or not; images of some hundred "
            "pixels a side and more. For white noise the gains are slopes over all levels; a "
            "nonlinearity of up to 2 % is not flagged.",
        ),
        "variance": Description(
            "charact.estimators.noise.variance",
            (
                "system_gain",
                "read_noise",
                "quantum_efficiency",
                "saturation",
                "snr_max",
                "dynamic_range",
            ),
            "Cameras with white noise; blur after the gain stage lowers the result by the blur "
            "factor. A nonlinearity of up to 2 % over the levels lowers it by up to 6 % without a "
            "flag, as in the standard.",
        ),
        "uneven-scene": Description(
            "charact.estimators.noise.uneven_scene",
            ("system_gain", "read_noise", "saturation", "saturation_capacity"),
            "Two or more frames of any still scene whose light spans a factor of 1.5 and more, and "
            "darks for the noise; cameras with white noise. Pixels are binned by signal; full "
            "wells in part of the picture are left out. Motion and flicker within the scene raise "
            "the gain.",
        ),
    },
    "bloom": {
        "series-forward": Description(
            "charact.estimators.bloom.series_forward",
            ("halo_diameter", "halo_fraction", "bloom_diameter", "streak_length"),
            (
                "A round source with a halo edge above the noise in at least one stack, at any "
                "saturation."
            ),
        ),
    },
    "lit-edge": {
        "lit-edge": Description(
            "charact.estimators.bloom.lit_edge_halo",
            ("halo_diameter", "halo_fraction"),
            "A straight edge of a bright area, four times as long as the halo radius, next to a "
            "dark area; preferably with one unclipped stack.",
        ),
    },
    "fusion": {
        "noise-aware": Description(
            "charact.fusion.noise_aware",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            "Registered bands of known noise; blooming is removed where a bloom map is given. One "
            "grey picture: contrasts of opposite sign in two bands of equal noise cancel. Without "
            "a noise law weights are estimated from the frame, and flagged.",
        ),
        "noise-aware-colour": Description(
            "charact.fusion.noise_aware",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            "As noise-aware, in colour: keeps contrasts of opposite sign and nearly all evidence "
            "of both bands; pixel noise is not reduced.",
        ),
        "weighted": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            "For comparison: addition of bands stretched from their least to their highest pixel; "
            "a clipped lamp compresses all else.",
        ),
        "pca": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            (
                "For comparison: weights of the first principal component; noise and lamps are "
                "variance and take weight."
            ),
        ),
        "inverse-noise": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            "For comparison: weights of 1 over the noise power of each pixel. Halos stay, and "
            "weights that change make steps.",
        ),
        "laplacian": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            (
                "For comparison: largest detail of each pyramid level. Selects noise and the rims "
                "of halos."
            ),
        ),
        "guided-filter": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            "For comparison: weights of saliency smoothed by a guided filter; noise is salient.",
        ),
        "opponent": Description(
            "charact.fusion.rules",
            ("fusion_error", "fused_noise", "fused_share", "fused_filled_area"),
            (
                "For comparison: opponent colours of the first two bands; the local gain raises "
                "noise and halo rims."
            ),
        ),
    },
}
