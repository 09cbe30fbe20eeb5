"""Fixtures of the plate, for the tests that have none of their own."""

from tests.support.plate import faults as faults
from tests.support.plate import plate as plate
