"""Every sampler keeps the contract, one of a user's own among them."""

from dataclasses import dataclass

import numpy as np
from contract_sampler import SamplerContract
from test_settings_tree import Learnability as OwnLearnability

from pecjax import curriculum as c


class TestPEC(SamplerContract):
    settings = c.PEC(alpha=0.2)


class TestUniform(SamplerContract):
    settings = c.Uniform()


class TestForgetting(SamplerContract):
    settings = c.Forgetting()


class TestFailureEMA(SamplerContract):
    settings = c.FailureEMA()


class TestLearnability(SamplerContract):
    settings = c.Learnability()


class TestPassAtN(SamplerContract):
    settings = c.PassAtN()


class TestTableTop(SamplerContract):
    settings = c.TableTop()


class TestThompson(SamplerContract):
    settings = c.Thompson()


class TestLearningProgress(SamplerContract):
    settings = c.LearningProgress()


class TestDRO(SamplerContract):
    settings = c.DRO()


class TestPLR(SamplerContract):
    settings = c.PLR()


class TestPLRInProportion(SamplerContract):
    settings = c.PLR(rank=False)


class TestSFL(SamplerContract):
    settings = c.SFL()


class TestFloor(SamplerContract):
    settings = c.Floor(c.Thompson())


class TestMixture(SamplerContract):
    settings = c.Mixture(c.DRO(), c.Floor())


class TestPerStep(SamplerContract):
    settings = c.PerStep(c.Learnability())


class TestOwn(SamplerContract):
    settings = OwnLearnability(floor=0.05)


@dataclass(frozen=True)
class InPairs(c.SamplerSettings):
    """Two configurations each learn together, as a user would have it."""

    alpha: float = 0.2

    def make(self, num_configs):
        return c.by_group(c.pec((num_configs + 1) // 2, self.alpha), np.arange(num_configs) // 2)


class TestByGroup(SamplerContract):
    settings = InPairs()
