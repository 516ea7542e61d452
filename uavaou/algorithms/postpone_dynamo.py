"""Torch's compiler, imported only by who compiles.

Every optimizer of torch imports ``torch._dynamo`` when it is made, so that a compiled function knows what not to
compile. That import takes 1.5 s, half of what else passes before a training begins or a policy flies.
"""

import sys
from collections.abc import Callable
from typing import Any

from torch import _compile
from torch.optim import Optimizer

_KEPT = "__dynamo_disable"  # where torch keeps the function that it calls instead


def postpone_dynamo() -> None:
    """Let torch's optimizers import the compiler only after the program has; what they compute stays the same."""
    for method in vars(Optimizer).values():
        function = getattr(method, "__wrapped__", None)
        wrapped_by = getattr(getattr(method, "__code__", None), "co_filename", None)
        if function is not None and wrapped_by == _compile.__file__ and not hasattr(function, _KEPT):
            setattr(function, _KEPT, _postponed(function))


def _postponed(function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        dynamo = sys.modules.get("torch._dynamo")
        if dynamo is None:  # nothing can be being compiled
            return function(*args, **kwargs)
        setattr(function, _KEPT, dynamo.disable(function, True, wrapping=False))  # as torch does
        return getattr(function, _KEPT)(*args, **kwargs)

    return call
