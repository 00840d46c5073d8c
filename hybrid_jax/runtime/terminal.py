# SPDX-License-Identifier: MIT
"""Output of the commands: answers on stdout, all else on stderr, errors as one sentence.

Exit codes: 0 done; 1 done, and the answer is no (no plan, a cell that is not fit); 2 bad input, or
a file that cannot be read or written; 70 a defect of this package; 130 stopped by Ctrl-C.
"""

import _thread
import gc
import json
import os
import sys
import threading
import traceback
from collections.abc import Callable

import tyro

from hybrid_jax.errors import HybridJaxError

BAD_INPUT, DEFECT, STOPPED = 2, 70, 130
MOST_SAID = 2000
"""Largest number of characters of a message that are printed."""


def remark(text: str) -> None:
    """Print a message that is not the answer, on stderr."""
    print(text, file=sys.stderr, flush=True)


def answer(text: str, values: dict | list, as_json: bool) -> None:
    """Print the answer of a command: lines for people, or one JSON value for programs."""
    print(json.dumps(values, indent=1) if as_json else text, flush=True)


def _interrupt_again(dropped) -> None:
    """Raise a Ctrl-C again that Python dropped.

    Python drops exceptions of destructors and of the garbage collector's callbacks, Ctrl-C too.
    JAX has such a callback, in which one Ctrl-C of five fell while it compiled.
    """
    if dropped.exc_type is KeyboardInterrupt:
        threading.Timer(0.05, _thread.interrupt_main).start()  # once this has been left
    else:
        sys.__unraisablehook__(dropped)


def collect_garbage_rarely() -> None:
    """Let Python look for garbage more rarely: tracing a program makes many objects that stay."""
    gc.set_threshold(100_000, 50, 50)


def run_cli(command: Callable[[], int]) -> None:
    """Run a command and exit with its code; errors are printed as one sentence."""
    sys.unraisablehook = _interrupt_again
    collect_garbage_rarely()
    os.environ["JAX_ENABLE_X64"] = "0"  # the kernels' arrays are float32
    try:
        code = command()
    except HybridJaxError as error:
        remark(f"error: {_cut(str(error))}")
        code = BAD_INPUT
    except KeyboardInterrupt:
        remark("\nstopped")
        code = STOPPED
    except BrokenPipeError:  # the reader of a pipe has gone: nobody is left to tell
        sys.stderr.close()
        code = BAD_INPUT
    except OSError as error:
        place = f" {error.filename}" if error.filename else ""
        remark(f"error: cannot read or write{place}: {error.strerror or error}")
        code = BAD_INPUT
    except Exception:
        traceback.print_exc()
        remark("error: this is a defect of hybrid_jax; please report it with the lines above")
        code = DEFECT
    if code == STOPPED:
        # where Ctrl-C fell into code made of text, as dataclasses make theirs, Python would end
        # itself by SIGINT, whatever code it is asked for
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _cut(text: str) -> str:
    return text if len(text) <= MOST_SAID else f"{text[:MOST_SAID]}..."


def run_main(main: Callable[..., int]) -> None:
    """Run a function as a command, with the terminal's arguments; see `run_cli`."""
    config = (tyro.conf.FlagCreatePairsOff,)
    run_cli(lambda: tyro.cli(main, prog=called_as(), config=config))


def run_subcommands(commands: dict[str, Callable[..., int]]) -> None:
    """Run one of several functions as a command; the terminal's first argument names it."""
    config = (tyro.conf.FlagCreatePairsOff,)
    cli = tyro.extras.subcommand_cli_from_dict
    run_cli(lambda: cli(commands, prog=called_as(), config=config))


def called_as() -> str:
    """Name by which this process's command was called, for its usage line."""
    spec = sys.modules["__main__"].__spec__
    return f"python -m {spec.name.removesuffix('.__main__')}" if spec else sys.argv[0]
