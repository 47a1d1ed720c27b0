"""Sinks: listeners to a training, to give to `pecjax.train`; as `pecjax.sinks` from outside."""

from pecjax.training.sinks.base import Sink as Sink, Sinks as Sinks
from pecjax.training.sinks.callback import Callback as Callback
from pecjax.training.sinks.progress import Progress as Progress
from pecjax.training.sinks.tensorboard import TensorBoard as TensorBoard
from pecjax.training.sinks.wandb import WandB as WandB
