"""What a report says of the process and the libraries it ran on."""

from __future__ import annotations

import ctypes
import functools
import gc
import platform
import resource
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("torchmat", "torch", "numpy", "kornia", "OpenImageIO", "scikit-learn")


_earlier_peak_mb = 0.0  # the largest of the marks that `MemoryMark` wiped


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far, in MB."""
    # getrusage would count what the parent held when it forked; the kernel's own high-water mark does not.
    mark = _status_mb("VmHWM")
    if mark is not None:
        return max(mark, _earlier_peak_mb)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def _status_mb(name: str) -> float | None:
    """Return a figure of the kernel's account of this process, in MB; None where there is no such account."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text().splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) * 1024 / 1e6
    return None


def give_back() -> None:
    """Give memory that was freed back to the system, where the allocator keeps it (glibc)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


class MemoryMark:
    """Measures what a piece of work takes on top of what the process holds when it begins (Linux; else None).

    It wipes the kernel's high-water mark, which `peak_memory_mb` remembers. What earlier work freed is first given back
    to the system: memory that is taken again would not show.
    """

    def __init__(self) -> None:
        global _earlier_peak_mb
        gc.collect()
        give_back()
        self._held = None
        peak = _status_mb("VmHWM")
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
            self._held = _status_mb("VmRSS")
        if self._held is not None and peak is not None:
            _earlier_peak_mb = max(_earlier_peak_mb, peak)

    @property
    def taken_mb(self) -> float | None:
        """The most that was held since, beyond what was held at first, in MB."""
        peak = _status_mb("VmHWM")
        return None if self._held is None or peak is None else max(0.0, peak - self._held)


@functools.cache  # reading a package's description takes milliseconds, and every report names six
def package_version(package: str = "torchmat") -> str:
    """Return the installed version of a package, or "unknown"."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def versions() -> dict[str, str]:
    """Return the versions that decide a result."""
    return {"python": platform.python_version(), **{package: package_version(package) for package in _PACKAGES}}
