"""What exported C does, under sanitizers."""

import pytest

from tests.support.sanitizers import assert_nothing_found, needs_sanitizers

FILES = [f"export/test_export_{name}" for name in ("fmi3", "events", "loops")]
# Both versions and interfaces, events, loops, derivatives by direction and by states, states kept, and what fails.
CHOSEN = (
    "is_that_of_fmi_2 or is_saved_restored or refusals or closed_form and 0.35 or frozen or chattering or not_finite "
    "or saved_state or singular or whole_simulations"
)


@pytest.mark.slow
@needs_sanitizers
def test_sanitizers_find_nothing() -> None:
    assert_nothing_found("tests.support.sanitized_exports", FILES, ["-k", CHOSEN])
