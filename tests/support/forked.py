"""A process that has all modules of this one: a new interpreter takes seconds to import them."""

from __future__ import annotations

import multiprocessing
import warnings
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any


def forked(task: Callable[..., Any], *arguments: Any) -> BaseProcess:
    """Start a function in a copy of this process."""
    process = multiprocessing.get_context("fork").Process(target=task, args=arguments)
    with warnings.catch_warnings():
        # Of Python 3.12 and later, if this process has threads: the copy uses none of them.
        warnings.filterwarnings("ignore", message=".*fork", category=DeprecationWarning)
        process.start()
    return process
