"""The curriculum: chooses the configuration of the next episode. Arrays only, no simulator."""

from pecjax.curriculum.base import (
    Outcomes as Outcomes,
    Sampler as Sampler,
    SamplerSettings as SamplerSettings,
    by_config as by_config,
    count_outcomes as count_outcomes,
)
from pecjax.curriculum.by_group import bins as bins, by_group as by_group
from pecjax.curriculum.counts import from_counts as from_counts
from pecjax.curriculum.diagnostics import diagnose as diagnose
from pecjax.curriculum.draws import sample_ids as sample_ids
from pecjax.curriculum.dro import DRO as DRO, dro as dro
from pecjax.curriculum.failure_ema import FailureEMA as FailureEMA, failure_ema as failure_ema
from pecjax.curriculum.floor import Floor as Floor, floor as floor
from pecjax.curriculum.forgetting import Forgetting as Forgetting, forgetting as forgetting
from pecjax.curriculum.learnability import Learnability as Learnability, learnability as learnability
from pecjax.curriculum.learning_progress import (
    LearningProgress as LearningProgress,
    learning_progress as learning_progress,
)
from pecjax.curriculum.mixture import Mixture as Mixture, mixture as mixture
from pecjax.curriculum.pass_at_n import PassAtN as PassAtN, pass_at_n as pass_at_n
from pecjax.curriculum.pec import PEC as PEC, pec as pec
from pecjax.curriculum.per_step import PerStep as PerStep, per_step as per_step
from pecjax.curriculum.plr import PLR as PLR, plr as plr
from pecjax.curriculum.sfl import SFL as SFL, sfl as sfl
from pecjax.curriculum.statistics import from_statistics as from_statistics
from pecjax.curriculum.table_top import TableTop as TableTop, table_top as table_top
from pecjax.curriculum.thompson import Thompson as Thompson, thompson as thompson
from pecjax.curriculum.uniform import Uniform as Uniform, uniform as uniform
