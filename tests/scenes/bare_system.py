"""A Python as on systems that are not POSIX: tiler's modules find neither the modules nor the functions of POSIX alone.

Libraries find all of them, as those that are installed here expect them. Put the text of this file into a folder of
``PYTHONPATH`` as ``sitecustomize.py``, and it holds for every process.
"""

from __future__ import annotations

import builtins
import os
import signal
import types
from typing import Any

MISSING_MODULES = frozenset(
    (
        "curses",
        "fcntl",
        "grp",
        "posix",
        "pty",
        "pwd",
        "readline",
        "resource",
        "syslog",
        "termios",
        "tty",
    )
)
MISSING = {
    "os": """chown confstr ctermid fchmod fchown fdatasync fork forkpty getegid geteuid getgid getgroups getloadavg
        getpgid getpgrp getpriority getsid getuid initgroups killpg lchown major minor mkfifo mknod nice openpty
        pathconf pipe2 posix_fadvise posix_fallocate posix_spawn pread preadv pwrite pwritev readv register_at_fork
        sched_getaffinity sched_setaffinity sched_yield sendfile set_blocking setpgid setpriority setsid setuid statvfs
        sync sysconf tcgetpgrp ttyname uname wait wait3 wait4 writev WIFEXITED WIFSIGNALED WTERMSIG EX_OK O_CLOEXEC
        O_DIRECTORY O_NOFOLLOW O_NONBLOCK""",
    "signal": """SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGTTIN SIGTTOU
        SIGUSR1 SIGUSR2 SIGWINCH alarm getitimer pause pthread_kill pthread_sigmask setitimer siginterrupt sigpending
        sigwait""",
}
OWN = ("tiler", "ptd", "cli")


def without(module: types.ModuleType, names: str) -> types.ModuleType:
    """A module that has all of another one but some names."""
    bare = types.ModuleType(module.__name__)
    vars(bare).update(
        {name: value for name, value in vars(module).items() if name not in names.split()}
    )
    return bare


BARE = {"os": without(os, MISSING["os"]), "signal": without(signal, MISSING["signal"])}
found = builtins.__import__


def bare_import(
    name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
) -> Any:
    importer = (globals or {}).get("__name__") or ""
    if importer == "__main__":  # `python -m`
        importer = getattr((globals or {}).get("__spec__"), "name", "") or ""
    if level or importer.partition(".")[0] not in OWN:
        return found(name, globals, locals, fromlist, level)
    if name in MISSING_MODULES:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return BARE.get(name) or found(name, globals, locals, fromlist, level)


# and not where a test imports this module to find its file
if __name__ in ("sitecustomize", "bare_system"):
    builtins.__import__ = bare_import
