"""The application: its commands, how they are run, and how they end.

Whatever the user can get wrong ends as one line on stderr and exit code 2; Ctrl-C as exit code 130.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from silint import __version__
from silint.cli.bake import bake_command
from silint.cli.bench import bench_command
from silint.cli.demo import demo_command
from silint.cli.info import info_command
from silint.cli.prt import prt_command

__all__ = ["app", "main", "run"]

EXIT_INPUT, EXIT_INTERRUPTED, EXIT_BUG = 2, 130, 1

app = typer.Typer(
    name="silint",
    help="Noise-free ambient occlusion and sky visibility of triangle meshes, from silhouettes, not rays.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("demo")(demo_command)
app.command("bake")(bake_command)
app.command("prt")(prt_command)
app.command("bench")(bench_command)
app.command("info")(info_command)


def main() -> None:
    """Run the command line; the entry point of the package."""
    # OpenMP's idle threads spin by default and take the cores from whatever else runs: several times slower
    # on a busy machine, no faster on a quiet one. It reads this when it starts, which it has not yet.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _stop_at_ctrl_c()
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Exit code of a command line, with every expected failure told in one line on stderr."""
    # ValueErrors that are not InputErrors are bugs, and look like bugs.
    from silint.validation import InputError

    try:
        code = app(args=arguments or ["--help"], prog_name="silint", standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except InputError as error:
        return _fail(str(error))
    except (KeyboardInterrupt, typer.Abort):
        return EXIT_INTERRUPTED
    except typer.Exit as stop:
        return int(stop.exit_code)
    except BrokenPipeError:
        # The reader of our output has gone (`silint info x | head`): end quietly, as typer does itself where
        # it notices first. Python's own flush at exit must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError:
        return _fail("out of memory; use a smaller mesh or fewer isolines")
    except Exception as error:
        # typer's and click's usage errors come from whichever of the two this version of typer is built on.
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            return _fail(f"{error.format_message()} (try 'silint --help')")
        if os.environ.get("SILINT_DEBUG"):
            raise
        print(
            f"silint: internal error, please report it: {type(error).__name__}: {_one_line(str(error))} "
            "(SILINT_DEBUG=1 shows where)",
            file=sys.stderr,
        )
        return EXIT_BUG


def _stop_at_ctrl_c() -> None:
    """Make Ctrl-C end the process at once, whatever it is doing.

    Python's own way, an exception in the main thread, has to wait until compiled code returns, and is lost
    when it strikes inside one of the compiler's callbacks (measured: the demo then ran to its end). Here a
    thread waits for the signal, removes what is half-written, and leaves.
    """
    import signal
    import socket
    import threading

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return  # somebody else's business, or ignored as under nohup
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)

    def wait(sender: socket.socket) -> None:  # the argument keeps the socket alive
        while receiver.recv(1)[0] != signal.SIGINT:
            pass
        if "silint.io" in sys.modules:
            from silint.io.unfinished import discard_unfinished

            discard_unfinished()
        # Progress bars hide the cursor; and the shell's prompt belongs on a line of its own.
        told = "\x1b[?25h\n" if os.isatty(2) else ""
        os.write(2, f"{told}silint: interrupted, nothing is left half-written\n".encode())
        os._exit(EXIT_INTERRUPTED)

    threading.Thread(target=wait, args=(sender,), daemon=True).start()


def _fail(message: str) -> int:
    print(f"silint: error: {_one_line(message)}", file=sys.stderr)
    return EXIT_INPUT


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"silint {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Noise-free ambient occlusion and sky visibility of triangle meshes, from silhouettes, not rays."""
