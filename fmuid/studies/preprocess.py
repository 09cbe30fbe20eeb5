"""The table ``[experiments.preprocess]`` of a study file: what is done with a table before it is an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

from pydantic import AfterValidator, Field, Tag

from fmuid.data import FILLS, TRENDS, ParkTransform, Preprocessing
from fmuid.studies.section import StudySection, word
from fmuid.studies.value_kinds import (
    BY_SHAPE,
    TABLE_TAG,
    VALUE_TAG,
    Entries,
    Finite,
    Names,
    Positive,
    Text,
    Texts,
    ValueKind,
    must_be,
    one_of,
)

SEGMENTS = "a list of pairs of times, [[0.0, 1.5], [2.0, 3.5]]"


def _forwards(pieces: list[list[float]]) -> list[list[float]]:
    if any(end <= begin for begin, end in pieces):
        raise must_be(f"{SEGMENTS}, each with the earlier time first")
    return pieces


Segments = Annotated[
    list[Annotated[list[Finite], Field(min_length=2, max_length=2)]], ValueKind(SEGMENTS), AfterValidator(_forwards)
]
Trend = Annotated[str, one_of(tuple(TRENDS))]
Fills = Annotated[dict[str, Annotated[str, one_of(FILLS)]], Entries('a table { column = "linear" or "zoh" }')]
Trends = Annotated[dict[str, Trend], Entries("a table { column = trend }")]


class ParkWords(StudySection):
    """Three phases as two axes that turn (Park), or the way back."""

    source: Names = word(..., "three phases, which become two axes, or two axes, which become three phases")
    target: Names = word(..., "the new columns")
    angle: Text | None = word(None, "the column of the angle, rad or what the table says; default: speed is integrated")
    speed: Text | None = word(None, "the column of the speed, rad/s or what the table says")
    pole_pairs: Positive = word(1.0, "what angle or speed are multiplied by; 1 where they are electrical")
    initial_angle: Finite = word(0.0, "the electrical angle where the integration begins, rad")

    def settings(self) -> ParkTransform:
        """Return the words as an object.

        Raises
        ------
        InputError
            If they do not go together.
        """
        if sorted((len(self.source), len(self.target))) != [2, 3]:
            raise self.error("has source and target of other lengths: name three phases and two axes, either way round")
        if (self.angle is None) == (self.speed is None):
            raise self.error("must have one of angle and speed: name the column")
        names = tuple(self.source), tuple(self.target)
        return ParkTransform(*names, self.angle, self.speed, self.pole_pairs, self.initial_angle)


class PreprocessWords(StudySection):
    """What is done with the table, in the order of these words."""

    computed_columns: Texts = word(
        {}, 'columns computed from others, { x = "pulses * 35.1 + vir" }, also in place of what is there'
    )
    fill_missing: Fills = word(
        {}, 'inputs whose missing samples are filled, { u = "linear" }, or "zoh", the sample before'
    )
    max_gap: Positive | None = word(None, "s: a longer gap is not filled but refused; default: 20 usual steps")
    park: list[ParkWords] = word([], "phases transformed to turning axes, or back")
    lowpass_frequency: Positive | None = word(
        None, "Hz: inputs and outputs without what is faster, nothing shifted in time"
    )
    start_time: Finite | None = word(None, "s: the data are kept from there")
    end_time: Finite | None = word(None, "s: and up to there")
    segments: Segments = word(
        [], "in place of start_time and end_time: several segments, each an experiment of its own"
    )
    resample_interval: Positive | None = word(None, "step of time, s")
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
        if self.start_time is not None and self.end_time is not None and self.end_time <= self.start_time:
            times = f"start_time = {self.start_time:g} and end_time = {self.end_time:g}"
            raise self.error(f"has {times}: give the earlier time first")
        if self.max_gap is not None and not self.fill_missing:
            raise self.error('has max_gap and nothing to fill: name the columns, fill_missing = { u = "linear" }')
        axes = tuple(each.settings() for each in self.park)
        cut = self.lowpass_frequency, self.start_time, self.end_time, self.resample_interval
        return Preprocessing(self.computed_columns, axes, *cut, self.detrend, self.fill_missing, self.max_gap)

    def check_fill(self, outputs: Mapping[str, str]) -> None:
        """Check that no measurements are made up: an `InputError` where a column of an output is filled."""
        for name, column in outputs.items():
            if column in self.fill_missing:
                raise self.error(
                    f"fills {column!r}, what was measured of the output {name!r}: leave it out of fill_missing, "
                    "missing samples of an output do not count"
                )

    def cut_up(self) -> Sequence[PreprocessWords]:
        """Return the words of each segment.

        Raises
        ------
        InputError
            If there are both segments and one cut.
        """
        self.settings()  # checks them
        if not self.segments:
            return [self]
        for key, given in (("start_time", self.start_time), ("end_time", self.end_time)):
            if given is not None:
                raise self.error(f"has both segments and {key}: keep one of the two")
        return [
            self.model_copy(update={"start_time": begin, "end_time": end, "segments": []})
            for begin, end in self.segments
        ]
