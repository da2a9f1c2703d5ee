"""Result of an analysis in a script or notebook: quantities as attributes, plot, table, export."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from charact.reporting.summary import summary_of
from labdata import QUANTITIES, BadInput, Measurement, Result, Session

if TYPE_CHECKING:
    import pandas
    import xarray

    from charact.verdict.purpose import Decision

SHOWN = 3  # Quantities of the short text


@dataclass(frozen=True, kw_only=True, repr=False)
class Analysis(Result):
    """Result of one analysis: a `labdata.measurement.Result` with each measured quantity as an
    attribute.

    Examples
    --------
    >>> from labdata.measurement import measurement_from_sd
    >>> mtf50 = measurement_from_sd("mtf50", "cy/px", 0.2, 0.001, method="edge-slanted")
    >>> found = Analysis(measurements=(mtf50,))
    >>> found.mtf50.value
    0.2
    >>> found
    <Analysis: mtf50 = 0.20000 ± 0.00196 cy/px, ok>
    """

    source: str = "array"  #: File or session measured
    #: The session measured, whose conditions `charact.compare` requires to be alike
    session: Session | None = None
    #: Whether the session is enough for a purpose; None where one analysis alone was made
    verdict: "Decision | None" = None

    @classmethod
    def of(
        cls,
        result: Result,
        source: str,
        session: Session | None = None,
        verdict: "Decision | None" = None,
    ) -> "Analysis":
        """Return a result with what was measured."""
        values = {item.name: getattr(result, item.name) for item in fields(Result)}
        return cls(**values, source=source, session=session, verdict=verdict)

    def __getattr__(self, quantity: str) -> Measurement:
        """Return the only measurement of a quantity, or the only one with a value; of several, ask
        for `find`.
        """
        if quantity not in QUANTITIES:
            raise AttributeError(f"an Analysis has no attribute {quantity!r}")
        found = self.find(quantity)
        valued = [m for m in found if m.value is not None]
        if len(found) == 1 or len(valued) == 1:
            return (valued or found)[0]
        if not found:
            measured = ", ".join(dict.fromkeys(m.quantity for m in self.measurements))
            raise AttributeError(f"{quantity!r} was not measured, only {measured or 'nothing'}")
        differing = [
            name
            for name in (
                "unit",
                "stack",
                "region",
                "frequency_cy_per_px",
                "orientation_deg",
                "method",
            )
            if len({getattr(m, name) for m in found}) > 1
        ]
        example = (
            f"find({quantity!r}, {differing[0]}={getattr(found[0], differing[0])!r})"
            if differing
            else f"find({quantity!r})"
        )
        raise AttributeError(
            f"{len(found)} measurements of {quantity!r}, which differ in {differing}: {example}[0]"
        )

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(m.quantity for m in self.measurements)})

    def __repr__(self) -> str:
        valued = [m for m in self.measurements if m.value is not None]
        shown = map(repr, valued[:SHOWN])
        more = [f"{len(valued) - SHOWN} more"] if len(valued) > SHOWN else []
        refused = len(self.measurements) - len(valued)
        return (
            "<Analysis: "
            f"{'; '.join((*shown, *more, *([f'{refused} refused'] if refused else ())))}>"
        )

    def __str__(self) -> str:
        return summary_of(self, title=self.source).replace(" (`everything`)", "")

    def _repr_html_(self) -> str:
        """Return the table and the MTF figure of the report, for a notebook."""
        from charact.reporting.session_page import fragment

        return fragment(self)

    def plot(
        self, path: str | Path | None = None, *, kind: str | None = None, axes: Any = None
    ) -> Any:
        """Plot the curves with their 95 % bands, or another figure of the report.

        Parameters
        ----------
        path
            File to save the figure to: .png, .svg or .pdf; None: none.
        kind
            "curves", or a name of `evidence`, such as "photon-transfer"; None: the curves of an
            MTF, else the leading figure, of noise photon transfer, of a bloom series its extent.
        axes
            Matplotlib axes to plot curves into; None: those of a new figure.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        BadInput
            If the result has no such figure, or the ending of the file is unknown.
        """
        from charact.reporting.figure_registry import FIGURES, kind_of
        from charact.reporting.mtf_curves import plot_files
        from charact.reporting.style import require_figure_file, save_figure, white_style

        if path is not None:
            require_figure_file(path)
        drawn = {
            name: FIGURES[kind_of(name, data)][1]
            for name, data in self.evidence.items()
            if kind_of(name, data) in FIGURES
        }
        kinds = [*(["curves"] if self.curves else []), *drawn]
        if not kinds or kind not in (None, *kinds):
            raise BadInput(
                f"`kind` must be one of {', '.join(kinds) or 'a result with figures'}, got {kind!r}"
            )
        chosen = kind or self._leading_figure(kinds)
        if chosen == "curves":
            figure = plot_files({"": self}, axes)
        else:
            with white_style():
                figure = drawn[chosen](self.evidence[chosen])
        if path is not None:
            save_figure(figure, path)
        return figure

    def _leading_figure(self, kinds: list[str]) -> str:
        """Return the figure that shows most of the result, of those that it has."""
        from charact.reporting.front_page import FIGURES

        if any(name.startswith("mtf") for name in self.curves):
            return "curves"
        leading = [kind for row in FIGURES for kind in row]
        return next((kind for kind in leading if kind in kinds), kinds[0])

    def to_frame(self) -> "pandas.DataFrame":
        """Return one row a measurement: quantity, unit, value, interval ends, status, flags, method
        and place.
        """
        pandas = _optional("pandas", "tables")
        return pandas.DataFrame([_row(m) for m in self.measurements])

    def to_xarray(self) -> "xarray.Dataset":
        """Return the curves against frequency, with their 95 % limits, as one data set."""
        xarray = _optional("xarray", "tables")
        variables, axes = {}, {}
        for name, curve in self.curves.items():
            axis = f"frequency_{name}" if len(self.curves) > 1 else "frequency"
            axes[axis] = (axis, curve.frequency_cy_per_px, {"units": "cy/px"})
            variables[name] = (axis, curve.value)
            if curve.interval95 is not None:
                variables[f"{name}_low95"] = (axis, curve.interval95[0])
                variables[f"{name}_high95"] = (axis, curve.interval95[1])
        return xarray.Dataset(variables, axes, attrs={"source": self.source})

    def to_arviz(self, quantity: str | None = None) -> "xarray.DataTree":
        """Return the posterior draws of a measurement as ArviZ takes them: a tree with the group
        "posterior".

        Parameters
        ----------
        quantity
            Name of a quantity; None: the first that has draws.

        Raises
        ------
        BadInput
            If there are no draws, or xarray is not installed.
        """
        xarray = _optional("xarray", "tables")
        having = [
            m
            for m in self.measurements
            if m.posterior is not None and quantity in (None, m.quantity)
        ]
        if not having or (posterior := having[0].posterior) is None:
            raise BadInput(
                f"no posterior draws of {quantity or 'any quantity'}: the method does not sample, "
                "or was quick"
            )
        draws = {
            name: (("chain", "draw"), posterior[name][None], {"units": unit})
            for name, unit in zip(posterior.names, posterior.units, strict=True)
        }
        about = {
            "sampler": posterior.sampler,
            "seed": posterior.seed,
            "quantity": having[0].quantity,
        }
        return xarray.DataTree.from_dict({"posterior": xarray.Dataset(draws, attrs=about)})


def _row(m: Measurement) -> dict[str, Any]:
    ends = {
        f"{side}{level}": None
        if (interval := getattr(m, f"interval{level}")) is None
        else interval[index]
        for level in (68, 95)
        for index, side in enumerate(("low", "high"))
    }
    plain = (
        "quantity",
        "unit",
        "value",
        "status",
        "method",
        "stack",
        "region",
        "frequency_cy_per_px",
        "orientation_deg",
        "seconds",
        "reason",
    )
    return {**{name: getattr(m, name) for name in plain}, **ends, "flags": ", ".join(m.flags)}


def _optional(name: str, extra: str) -> Any:
    """Import a library of an extra, or name the command that installs it."""
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError:
        raise BadInput(f"{name} is not installed: pip install 'charact[{extra}]'") from None
