"""The curriculum: which configuration comes next. Arrays only, no simulator."""

from pecjax.curriculum.base import (
    Outcomes as Outcomes,
    Sampler as Sampler,
    SamplerSettings as SamplerSettings,
    count_outcomes as count_outcomes,
)
from pecjax.curriculum.counts import from_counts as from_counts
from pecjax.curriculum.draws import sample_ids as sample_ids
from pecjax.curriculum.pec import PEC as PEC, pec as pec
from pecjax.curriculum.uniform import Uniform as Uniform, uniform as uniform
