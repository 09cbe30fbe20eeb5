"""Experiments of frequency responses: a row for each frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats
from fmuid.data.column_lookup import column_of
from fmuid.data.data_file import SOURCE, UNITS, numeric_column
from fmuid.data.experiment import Experiment
from fmuid.data.operating_points import ROW, check_rows, describe_rows, with_rows
from fmuid.errors import InputError
from fmuid.units import parse_unit, unit_in_name

RESPONSE_PARTS = ("real", "imaginary", "magnitude", "decibel", "phase")
DEGREE, DECIBEL = math.pi / 180.0, math.log(10.0) / 20.0
"""Of phases and decibels, the relative change of a response in one."""
RESPONSE_FORMS = (("real", "imaginary"), ("magnitude", "phase"), ("decibel", "phase"))
"""Pairs of columns of a response; each may be alone."""


@dataclass(frozen=True)
class Response:
    """Complex frequency response: a ratio of two signals, and the columns that hold it."""

    of: str
    """ratio of two signals of the FMU, such as "u / i", or "-u / i" for the reversed sign"""
    excited: str | None = None
    """input that is varied; default: the input in the ratio"""
    real: str | None = None
    """column of the real part"""
    imaginary: str | None = None
    """column of the imaginary part"""
    magnitude: str | None = None
    """column of the magnitude"""
    decibel: str | None = None
    """column of the magnitude in dB, 20 lg"""
    phase: str | None = None
    """column of the phase, degrees"""
    delay: float = 0.0
    """delay of the measured response, s; negative where the denominator is late"""
    conjugate: bool = False
    """the sign of imaginary part or phase is reversed, as in spectra of batteries: −Im"""

    def __post_init__(self) -> None:
        parts = [part.strip() for part in self.of.strip().removeprefix("-").split("/")]
        if not 1 <= len(parts) <= 2 or not all(parts):
            raise InputError(f'of = {self.of!r} is no ratio. Write it as "u / i".')
        if not self.columns:
            raise InputError("no column. Name real and imaginary, or magnitude or decibel, and phase.")
        if not any(set(self.columns) <= set(form) for form in RESPONSE_FORMS):
            named = " and ".join(self.columns)
            raise InputError(f"{named} cannot be combined. Name real and imaginary, or a magnitude and phase.")
        if len(set(self.columns.values())) < len(self.columns):
            raise InputError(f"{' and '.join(self.columns)} have the same column. Name one for each.")

    @property
    def signals(self) -> tuple[str, str]:
        """Numerator and denominator, "" for none."""
        above, _, below = self.of.strip().removeprefix("-").partition("/")
        return above.strip(), below.strip()

    @property
    def sign(self) -> float:
        """−1 if the ratio begins with a minus, else 1."""
        return -1.0 if self.of.strip().startswith("-") else 1.0

    @property
    def reversed_ratio(self) -> str:
        """The ratio with the reversed sign."""
        return self.of.strip().removeprefix("-") if self.sign < 0.0 else f"-{self.of.strip()}"

    @property
    def columns(self) -> dict[str, str]:
        """Parts to columns."""
        return {name: column for name in RESPONSE_PARTS if (column := getattr(self, name)) is not None}


def complex_values(parts: Mapping[str, Floats]) -> NDArray[np.complex128]:
    """Return a response (K,) by its parts; a missing part is 0, a missing magnitude 1."""
    none = np.zeros(len(next(iter(parts.values()))))
    if "real" in parts or "imaginary" in parts:
        found = parts.get("real", none) + 1j * parts.get("imaginary", none)
    else:
        size = parts.get("magnitude", np.exp(DECIBEL * parts.get("decibel", none)))
        found = size * np.exp(1j * DEGREE * parts.get("phase", none))
    return np.asarray(found, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class FrequencyExperiment(Experiment):
    """Frequency responses about an operating point; outputs are their parts, such as ``Z.real``.

    Parameters are those of `Experiment`, without times, inputs and outputs.

    Parameters
    ----------
    frequency : str
        Column of the frequency, Hz unless its unit is rad/s.
    responses : mapping of str to Response
    point : mapping of str to float
        Inputs of the FMU at the operating point; default: their start values.

    Examples
    --------
    >>> rows = pd.DataFrame({"f": [1.0, 10.0], "Re": [4.0, 4.0], "Im": [0.63, 6.3]})
    >>> spectrum = {"Z": fmuid.data.Response("u / i", real="Re", imaginary="Im")}
    >>> fmuid.data.FrequencyExperiment(rows, frequency="f", responses=spectrum)
    FrequencyExperiment('experiment', 2 rows, frequency → Z.real, Z.imaginary)
    """

    kind, least_rows = "frequency", 1
    frequency: str = "frequency"
    responses: Mapping[str, Response] = field(default_factory=dict)
    point: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_rows(self, {"frequency": self.frequency}, ("frequency",))
        self._set(frame=with_rows(self.frame), inputs={"frequency": self.frequency}, time=ROW, interpolation="zoh")
        self._set(outputs=response_columns(self.responses))
        self._convert_phases()
        super().__post_init__()
        for name, values in zip(self.output_names, self.output_values.T, strict=True):
            if self.part(name)[2] == "magnitude" and (below := values < 0.0).any():
                said = f"{self.source}: magnitude {self.columns[name]!r} is negative in row {below.argmax() + 1}"
                raise InputError(f"{said}. Use decibel for dB, or correct it.")
        for each in (one for one in self.responses.values() if {"real", "imaginary"} <= one.columns.keys()):
            parts = [numeric_column(self.frame, column, self.source) for column in each.columns.values()]
            if (half := np.logical_xor(*np.isnan(parts))).any():
                named = " and ".join(map(repr, each.columns.values()))
                raise InputError(f"{self.source}: one of {named} is empty in row {half.argmax() + 1}. Empty both.")

    def _convert_phases(self) -> None:
        """Convert phases to degrees."""
        units, there = dict(self.units), self.frame.attrs.get(UNITS, {})
        source = self.source or str(self.frame.attrs.get(SOURCE, "the table"))
        for name, each in self.responses.items():
            column = column_of(self.frame.columns, each.phase or "")
            unit = units.get(f"{name}.phase") or there.get(column) or unit_in_name(column or "", own="deg")
            if column is None or unit is None:
                continue
            own, degree = parse_unit(unit), parse_unit("deg")
            if own is None or degree is None or own.exponents != degree.exponents:
                raise InputError(f"{source}: phase {column!r} is in {unit!r}. Give it in deg or rad.")
            values = numeric_column(self.frame, column, source) * (own.factor / degree.factor)
            self._set(frame=self.frame.assign(**{column: values}))
            units[f"{name}.phase"] = "deg"
        self._set(units=units)

    @property
    def made_columns(self) -> frozenset[str]:
        """Row numbers."""
        return frozenset({ROW})

    @property
    def design(self) -> str:
        """Responses and operating point, as text."""
        return repr((dict(self.responses), dict(self.point)))

    @property
    def axis(self) -> dict[str, Floats]:
        """Frequencies (K,), in the unit of the data."""
        return {"frequency": self.input_values[:, 0]}

    @property
    def smooth_over(self) -> Floats | None:
        """Logarithms of the frequencies (K,)."""
        return np.asarray(np.log(np.maximum(self.input_values[:, 0], np.finfo(np.float64).tiny)))

    def __repr__(self) -> str:
        return describe_rows(self)

    def part(self, output: str) -> tuple[str, Response, str]:
        """Return name, response and part of an output."""
        name, _, part = output.rpartition(".")
        return name, self.responses[name], part

    def readings(self, output: str) -> Floats:
        """Return the change (K,) of an output by one relative unit."""
        name, response, part = self.part(output)
        if part in ("phase", "decibel"):
            return np.full(len(self.times), 1.0 / (DEGREE if part == "phase" else DECIBEL))
        columns = [self.output_names.index(f"{name}.{each}") for each in response.columns if each != "phase"]
        return np.asarray(np.linalg.norm(self.output_values[:, columns], axis=1))


def response_columns(responses: Mapping[str, Response]) -> dict[str, str]:
    """Return the outputs of responses, with their columns."""
    found = {f"{name}.{part}": column for name, each in responses.items() for part, column in each.columns.items()}
    if not found:
        raise InputError("no responses. Name at least one.")
    return found
