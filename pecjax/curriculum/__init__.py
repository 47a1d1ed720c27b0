"""The curriculum: which configuration comes next. Arrays only, no simulator."""

from pecjax.curriculum.pec import pec as pec
from pecjax.curriculum.sampler import Outcomes as Outcomes, Sampler as Sampler, tally as tally
from pecjax.curriculum.uniform import uniform as uniform
