"""Every sampler keeps the contract, one of a user's own among them."""

from contract_sampler import SamplerContract
from test_settings_tree import Learnability

from pecjax.curriculum import PEC, Uniform


class TestPEC(SamplerContract):
    settings = PEC(alpha=0.2)


class TestUniform(SamplerContract):
    settings = Uniform()


class TestLearnability(SamplerContract):
    settings = Learnability(floor=0.05)
