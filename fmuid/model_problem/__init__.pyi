from .checked_search import ACCURACIES as ACCURACIES
from .checked_search import identify as identify
from .problem import Problem as Problem
from .region import CheckedRegion as CheckedRegion
