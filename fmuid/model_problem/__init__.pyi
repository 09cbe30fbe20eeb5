from .checked_search import ACCURACIES as ACCURACIES
from .checked_search import identify as identify
from .checked_search import search_globally as search_globally
from .problem import Problem as Problem
