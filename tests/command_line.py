"""The command line in processes that a test can send signals to."""

import multiprocessing
import os
import shlex
import signal
import sys
from pathlib import Path
from typing import Any

from uavaou_cli.main import main

forked = multiprocessing.get_context("forkserver")
forked.set_forkserver_preload(
    ["uavaou.runs.train", "uavaou.experiments.run", "uavaou.algorithms.mappo", "uavaou_cli.main", "tests.preloaded"]
)


def start_command(arguments: str, stderr: Path) -> Any:
    """Start the command line in a process group of its own, as a shell does; its complaints go to a file."""
    process = forked.Process(target=_command, args=(arguments, stderr))
    process.start()
    return process


def _command(arguments: str, stderr: Path) -> None:
    os.setsid()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])  # a server of jobs has them blocked
    signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs are started with it ignored
    os.dup2(os.open(stderr, os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
    sys.exit(main(shlex.split(arguments)))
