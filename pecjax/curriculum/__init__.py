"""The curriculum: which configuration comes next. Arrays only, no simulator."""

from pecjax.curriculum.base import (
    Outcomes as Outcomes,
    Sampler as Sampler,
    count_outcomes as count_outcomes,
)
from pecjax.curriculum.draws import sample_ids as sample_ids
from pecjax.curriculum.pec import pec as pec
from pecjax.curriculum.uniform import uniform as uniform
