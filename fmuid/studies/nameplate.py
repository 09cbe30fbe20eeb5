"""The section ``[nameplate]`` and the prior that it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from fmuid.data import JointPrior, Nameplate
from fmuid.files import is_file
from fmuid.studies import value_kinds as kinds
from fmuid.studies.model import ParsedModel
from fmuid.studies.parameters import JointPriorSection
from fmuid.studies.section import SectionLocation, section_of

BY_NAMEPLATE = "nameplate"  # value of ``prior`` that takes it from the section ``[nameplate]``
PriorOrNameplate = Annotated[Annotated[str, kinds.one_of((BY_NAMEPLATE,))] | JointPriorSection, kinds.BY_SHAPE]


def nameplate_of(given: Mapping[str, str]) -> Nameplate:
    """Return a nameplate from texts, each checked; an `InputError` begins with ``--nameplate``."""
    keys = section_of(Nameplate).read(dict(given), SectionLocation("--nameplate", Path()))
    with SectionLocation("--nameplate", Path()).located():
        return Nameplate(**dict(keys))


def nameplate_offer(fmu: Path) -> list[str]:
    """Return a remark where the FMU has a declaration beside it."""
    there = is_file(fmu.with_suffix(".nameplate.toml"))
    return ['# prior = "nameplate"  # of [nameplate] with P, U, I, n, f as printed'] if there else []


def prior_by_nameplate(
    prior: str | JointPriorSection | None,
    plate: Nameplate | None,
    model: ParsedModel,
    names: Sequence[str],
    top: SectionLocation,
) -> JointPrior | None:
    """Return the prior of a nameplate, None where none is asked for; the FMU is simulated."""
    if plate is None or not isinstance(prior, str):
        if plate is not None:
            raise top.below(BY_NAMEPLATE).error('has no effect. Set prior = "nameplate" at the top of the file.')
        if isinstance(prior, str):
            raise top.below("prior").error("needs the section [nameplate]. Add it with P, U, I, n and f.")
        return None
    from fmuid.identification import nameplate_prior

    with top.below(BY_NAMEPLATE).located():
        return nameplate_prior(model.system(), plate, names, model.values)
