"""The command line of uavaou: one module a command, which parses, calls the library and prints."""

import signal
import sys

from uavaou.runs.interrupt import exit_code, interrupt_at_sigterm


def start() -> int:
    """The command ``uavaou``. An interrupt while its modules are imported is answered as a later one is."""
    terminated = signal.getsignal(signal.SIGTERM)
    interrupt_at_sigterm(signal.SIG_DFL)
    try:
        from uavaou_cli.main import main

        return main()
    except KeyboardInterrupt as error:
        print("uavaou: interrupted", file=sys.stderr)
        return exit_code(error)
    finally:
        signal.signal(signal.SIGTERM, terminated or signal.SIG_DFL)
