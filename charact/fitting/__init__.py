"""Fit of a sensor description to a session's measurements."""

from charact.fitting.fitted_session import proposed_description
from charact.fitting.observation import findings_of, misfit_finding, observations_of
from charact.fitting.prior import prior_of, values_of_description
from charact.fitting.sensor import (
    Model,
    description_from_posterior,
    fit_sensor,
    full_well_draws,
    inflate_errors,
    model_of,
    posterior_of,
)
from charact.fitting.slice_sampling import slice_sample
from charact.fitting.stack_levels import levels_of

__all__ = [
    "Model",
    "description_from_posterior",
    "findings_of",
    "fit_sensor",
    "full_well_draws",
    "inflate_errors",
    "levels_of",
    "misfit_finding",
    "model_of",
    "observations_of",
    "posterior_of",
    "prior_of",
    "proposed_description",
    "slice_sample",
    "values_of_description",
]
