"""Fit of a sensor description to a session's measurements."""

from charact.fitting import (  # noqa: F401  statistics that a fit loops over
    mtf_observations,
    silicon_observations,
    tube_dark_observations,
    tube_observations,
    tube_time_observations,
)
from charact.fitting.fitted_session import proposed_description
from charact.fitting.model import Model, inflate_errors, model_of, posterior_of
from charact.fitting.observation import Observation, findings_of, misfit_finding, observations_of
from charact.fitting.posterior_draws import draw_posterior
from charact.fitting.prior import prior_of, values_of_description
from charact.fitting.sensor import description_from_posterior, fit_sensor
from charact.fitting.stack_levels import SessionStacks, levels_of, stacks_of
from charact.fitting.well_evidence import ShownLevel, full_well_draws, shown_levels

__all__ = [
    "Model",
    "Observation",
    "SessionStacks",
    "ShownLevel",
    "description_from_posterior",
    "draw_posterior",
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
    "shown_levels",
    "stacks_of",
    "values_of_description",
]
