"""What a stack of frames holds, measured once for every method."""

from labdata.lazy_names import import_on_first_use

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.frames.clipping": "is_clipped is_clipped_at_black",
        "charact.frames.image_lag": "image_lag_model",
        "charact.frames.noise_law": "NoiseLaw",
        "charact.frames.rounding": "FEWEST_DIFFERENCES rounding_sd rounding_shifts rounding_step",
        "charact.frames.stack": "Stack",
        "charact.frames.thresholds": "CLIPPING",
    },
)
