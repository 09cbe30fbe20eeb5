from .apply import AppliedValue as AppliedValue
from .apply import apply_result as apply_result
from .apply import write_estimates as write_estimates
from .batch_words import summary_words as summary_words
from .batch_words import write_summary as write_summary
from .findings import Findings as Findings
from .words import describe as describe
