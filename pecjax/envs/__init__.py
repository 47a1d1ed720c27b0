"""Environments: the task contract, and the tasks that come with pecjax."""
