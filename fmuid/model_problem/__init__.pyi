from .checked_search import ACCURACIES as ACCURACIES
from .checked_search import identify as identify
from .prediction import OutputScore as OutputScore
from .prediction import Prediction as Prediction
from .prediction import estimates_for as estimates_for
from .prediction import predict as predict
from .problem import Problem as Problem
from .region import CheckedRegion as CheckedRegion
