"""Start values in the text of a model description: what is replaced, and that nothing else is."""

# ruff: noqa: E501  # model descriptions read best one variable a line

from collections.abc import Mapping
from pathlib import Path

import pytest

from fmuid import InputError
from fmuid.models import read_description, with_starts
from tests.support.fmu_texts import FMI_3, write_fmu

FMI_2 = """<?xml version="1.0" encoding="UTF-8"?>
<!-- <ScalarVariable name="a"><Real start="7"/></ScalarVariable> -->
<fmiModelDescription fmiVersion="2.0" modelName="Ä" guid='{g}' generationTool="fmuid">
<CoSimulation modelIdentifier="x"/>
<UnitDefinitions><Unit name="V"><BaseUnit/></Unit></UnitDefinitions>
<ModelVariables>
  <ScalarVariable
      description='start="1" > 0'
      name="a" valueReference="0" causality="parameter" variability="fixed" ><Real
      unit="V" start = '4.0' min="0"
  /></ScalarVariable>
  <!-- b --><ScalarVariable name="b &amp; &quot;c&quot;" valueReference="1" causality="parameter" variability="fixed"><Real/>\t</ScalarVariable>
  <ScalarVariable name="alias" valueReference="0" causality="local"><Real min="0"/></ScalarVariable>
  <ScalarVariable name="n" valueReference="0" causality="parameter" variability="fixed"><Integer start="1"/><Annotations>
    <Tool name="other"><Real start="5"/></Tool></Annotations></ScalarVariable>
  <ScalarVariable name="on" valueReference="0" causality="parameter" variability="fixed"><Boolean start="false"></Boolean></ScalarVariable>
  <ScalarVariable name="x[2]" valueReference="7" causality="parameter" variability="fixed"><Real start="1e-3"/></ScalarVariable>
</ModelVariables><ModelStructure/>
</fmiModelDescription><!-- end -->
"""


def note_2(*names: str) -> str:
    listed = "".join(f"<Start name={name}/>" for name in names)
    return f'<VendorAnnotations><Tool name="fmuid"><Applied>{listed}</Applied></Tool></VendorAnnotations>\n'


def replaced(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def applied(folder: Path, text: str | bytes) -> Mapping[str, float | int | bool | str]:
    return read_description(write_fmu(folder / "applied.fmu", text)).applied


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["UTF-8", "utf-8-sig", "ISO-8859-1", "UTF-16"])
def test_only_the_starts_and_the_annotation_change(tmp_path: Path, encoding: str, newline: str) -> None:
    text = FMI_2.replace("\n", newline).replace("UTF-8", encoding.replace("-sig", ""))
    changed = with_starts(text.encode(encoding), {"a": 0.1 + 0.2, "on": True, 'b & "c"': -2e-30, "n": 3.0, "x[2]": 5})
    expected = replaced(
        text,
        ("'4.0'", "'0.30000000000000004'"),
        ("<Real/>", '<Real start="-2e-30"/>'),
        ('<Integer start="1"/>', '<Integer start="3"/>'),
        ('"false"', '"true"'),
        ('"1e-3"', '"5.0"'),
        (
            f"<ModelVariables>{newline}",
            note_2('"a"', '"on"', '"b &amp; &quot;c&quot;"', '"n"', '"x[2]"') + f"<ModelVariables>{newline}",
        ),
    )
    assert changed.decode(encoding) == expected
    assert applied(tmp_path, changed) == {"a": 0.1 + 0.2, "on": True, 'b & "c"': -2e-30, "n": 3, "x[2]": 5.0}


def test_arrays_are_changed_element_by_element(tmp_path: Path) -> None:
    values = {"R": 5.5, "A[2,1]": 40.0, "A[1,3]": 30.0, "B[2]": 0.5, "k": 7.0}
    changed = with_starts(FMI_3.encode(), values).decode()
    listed = "".join(f'<Start name="{name}"/>' for name in values)
    note = f'<Annotations><Annotation type="org.fmuid.applied"><Applied>{listed}</Applied></Annotation></Annotations>\n'
    assert changed == replaced(
        FMI_3,
        ('start="4"', 'start="5.5"'),
        ("1  2 3\n    4 5 6", "1  2 30.0\n    40.0 5 6"),
        ('start="9"', 'start="9 0.5 9"'),
        ('start="-1"', 'start="7"'),
        ("</fmiModelDescription>", note + "</fmiModelDescription>"),
    )
    assert applied(tmp_path, changed) == values


@pytest.mark.parametrize("text", [FMI_2, FMI_3])
def test_what_is_applied_later_joins_what_was_applied_before(tmp_path: Path, text: str) -> None:
    first, second = ("a", "x[2]") if text is FMI_2 else ("R", "B[1]")
    once = with_starts(text.encode(), {first: 1.0})
    twice = with_starts(once, {first: 2.0, second: 3.0})
    assert applied(tmp_path, once) == {first: 1.0}
    assert applied(tmp_path, twice) == {first: 2.0, second: 3.0}
    assert twice == with_starts(text.encode(), {first: 2.0, second: 3.0})


def test_annotations_of_others_stay(tmp_path: Path) -> None:
    theirs = '<VendorAnnotations><Tool name="other"><Start name="a"/></Tool></VendorAnnotations>'
    text = FMI_2.replace("<ModelVariables>", theirs + "<ModelVariables>")
    assert applied(tmp_path, text) == {}
    changed = with_starts(text.encode(), {"x[2]": 2.0})
    own = '<Tool name="fmuid"><Applied><Start name="x[2]"/></Applied></Tool>'
    assert changed.decode() == replaced(
        text, ('"1e-3"', '"2.0"'), ("</VendorAnnotations>", own + "</VendorAnnotations>")
    )
    assert applied(tmp_path, changed) == {"x[2]": 2.0}


@pytest.mark.parametrize(
    ("text", "values", "message"),
    [
        (FMI_2, {"gone": 1.0}, "no scalar variable 'gone'"),
        (FMI_2, {"a[1]": 1.0}, r"no scalar variable 'a\[1\]'"),
        (FMI_2, {"n": 1.5}, "variable 'n': 1.5 is no start value of type Integer"),
        (FMI_2, {"n": True}, "True is no start value of type Integer"),
        (FMI_2, {"a": float("nan")}, "nan is no start value of type Real"),
        (FMI_2, {"n": float("inf")}, "inf is no start value of type Integer"),
        (FMI_2, {"on": 0.5}, "0.5 is no start value of type Boolean"),
        (FMI_3, {"A": 1.0}, "no scalar variable 'A'"),
        (FMI_3, {"A[3,1]": 1.0}, r"no scalar variable 'A\[3,1\]'"),
        (FMI_3, {"A[1]": 1.0}, r"no scalar variable 'A\[1\]'"),
        (FMI_3, {"A[0,1]": 1.0}, r"no scalar variable 'A\[0,1\]'"),
        (FMI_3.replace("4 5 6", "4 5"), {"A[1,1]": 1.0}, "array of 6 elements: start values .* must be one or 6"),
        ("<a", {"a": 1.0}, "not well-formed XML"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(text: str, values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_starts(text.encode(), values)
