from .apply import AppliedValue as AppliedValue
from .apply import apply_result as apply_result
from .apply import write_estimates as write_estimates
from .findings import Findings as Findings
