"""Torch's compiler is not imported unless the program imports it."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import pytest
import torch as th

from uavaou.algorithms.postpone_dynamo import postpone_dynamo

FUNCTION: Any = vars(th.optim.Optimizer)["add_param_group"].__wrapped__


def make_optimizer() -> th.optim.Optimizer:
    return th.optim.Adam([th.nn.Parameter(th.zeros(1))])


def test_an_optimizer_does_not_import_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(FUNCTION, "__dynamo_disable", raising=False)
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # an import is an error
    with pytest.raises(ImportError):
        make_optimizer()
    postpone_dynamo()
    make_optimizer()


def test_what_torch_does_is_done_where_it_has_been_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    def disable(function: Any, recursive: bool, wrapping: bool) -> Any:
        calls.append((function, recursive, wrapping))
        return function

    monkeypatch.delattr(FUNCTION, "__dynamo_disable", raising=False)
    monkeypatch.setitem(sys.modules, "torch._dynamo", SimpleNamespace(disable=disable))
    postpone_dynamo()
    make_optimizer()
    make_optimizer()
    assert calls == [(FUNCTION, True, False)]
