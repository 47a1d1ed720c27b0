"""Floor plans by the thousand: rooms, doors, corridors, pillars and furniture from a seed."""

from pecjax.envs.rooms.plans.families import FAMILIES as FAMILIES, Family as Family
from pecjax.envs.rooms.plans.generate import make_plans as make_plans
from pecjax.envs.rooms.plans.plans import Plans as Plans
