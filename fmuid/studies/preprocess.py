"""The table ``[experiments.prepare]`` of a study file: what is done with a table before it is an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import AfterValidator, Field, Tag

from fmuid.data import FILLS, TRENDS, ParkTransform, Preprocessing
from fmuid.studies.section import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Entries,
    Finite,
    Names,
    Positive,
    StudySection,
    Text,
    Texts,
    ValueKind,
    must_be,
    one_of,
    word,
)

PIECES = "a list of pairs of times, [[0.0, 1.5], [2.0, 3.5]]"


def _forwards(pieces: list[list[float]]) -> list[list[float]]:
    if any(end <= begin for begin, end in pieces):
        raise must_be(f"{PIECES}, each with the earlier time first")
    return pieces


Pieces = Annotated[
    list[Annotated[list[Finite], Field(min_length=2, max_length=2)]], ValueKind(PIECES), AfterValidator(_forwards)
]
Trend = Annotated[str, one_of(tuple(TRENDS))]
Fills = Annotated[dict[str, Annotated[str, one_of(FILLS)]], Entries('a table { column = "linear" or "hold" }')]
Trends = Annotated[dict[str, Trend], Entries("a table { column = trend }")]


class AxesSection(StudySection):
    """Three phases as two axes that turn (Park), or the way back."""

    source: Names = word(
        ..., "three phases, which become two axes, or two axes, which become three phases", alias="from"
    )
    target: Names = word(..., "the new columns", alias="to")
    angle: Text | None = word(None, "the column of the angle, rad or what the table says; default: speed is integrated")
    speed: Text | None = word(None, "the column of the speed, rad/s or what the table says")
    pole_pairs: Positive = word(1.0, "what angle or speed are multiplied by; 1 where they are electrical")
    start: Finite = word(0.0, "the electrical angle where the integration begins, rad")

    def settings(self) -> ParkTransform:
        """Return the words as an object.

        Raises
        ------
        InputError
            If they do not go together.
        """
        if sorted((len(self.source), len(self.target))) != [2, 3]:
            raise self.error("has from and to of other lengths: name three phases and two axes, either way round")
        if (self.angle is None) == (self.speed is None):
            raise self.error("must have one of angle and speed: name the column")
        names = tuple(self.source), tuple(self.target)
        return ParkTransform(*names, self.angle, self.speed, self.pole_pairs, self.start)


class PrepareSection(StudySection):
    """What is done with the table, in the order of these words."""

    columns: Texts = word(
        {}, 'columns computed from others, { x = "pulses * 35.1 + vir" }, also in place of what is there'
    )
    fill: Fills = word({}, 'inputs whose missing samples are filled, { u = "linear" }, or "hold", the sample before')
    longest_gap: Positive | None = word(None, "s: a longer gap is not filled but refused; default: 20 usual steps")
    axes: list[AxesSection] = word([], "phases transformed to turning axes, or back")
    low_pass: Positive | None = word(None, "Hz: inputs and outputs without what is faster, nothing shifted in time")
    start: Finite | None = word(None, "s: the table is kept from there", alias="from")
    end: Finite | None = word(None, "s: and up to there", alias="to")
    pieces: Pieces = word([], "in place of from and to: several pieces, each an experiment of its own")
    resample: Positive | None = word(None, "step of time, s")
    detrend: Annotated[Annotated[Trend, Tag(VALUE_TAG)] | Annotated[Trends, Tag(TABLE_TAG)], BY_SHAPE] | None = word(
        None, "what is taken from inputs and outputs, or from some columns: { column = trend }"
    )

    def settings(self) -> Preprocessing:
        """Return the words as an object.

        Raises
        ------
        InputError
            If they do not go together.
        """
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise self.error(f"has from = {self.start:g} and to = {self.end:g}: give the earlier time first")
        if self.longest_gap is not None and not self.fill:
            raise self.error('has longest_gap and nothing to fill: name the columns, fill = { u = "linear" }')
        axes = tuple(each.settings() for each in self.axes)
        how = self.low_pass, self.start, self.end, self.resample, self.detrend, self.fill, self.longest_gap
        return Preprocessing(self.columns, axes, *how)

    def check_fill(self, outputs: Mapping[str, str]) -> None:
        """Check that no measurements are made up: an `InputError` where a column of an output is filled."""
        for name, column in outputs.items():
            if column in self.fill:
                raise self.error(
                    f"fills {column!r}, what was measured of the output {name!r}: leave it out of fill, missing "
                    "samples of an output do not count"
                )

    def cut_up(self) -> Sequence[PrepareSection]:
        """Return the words of each piece.

        Raises
        ------
        InputError
            If there are both pieces and one cut.
        """
        self.settings()  # checks them
        if not self.pieces:
            return [self]
        for key, given in (("from", self.start), ("to", self.end)):
            if given is not None:
                raise self.error(f"has both pieces and {key}: keep one of the two")
        return [self.model_copy(update={"start": begin, "end": end, "pieces": []}) for begin, end in self.pieces]
