"""The kernel and the processors: preemption, frequency, isolation, clock, and what is kept from
real-time tasks."""

from __future__ import annotations

import gzip
import os
import platform
from pathlib import Path

from tonus.tools.doctor.files import read
from tonus.tools.doctor.finding import Finding, Verdict

_CPU = Path("/sys/devices/system/cpu")
_CLOCK = Path("/sys/devices/system/clocksource/clocksource0")
_PREEMPT = "/sys/kernel/debug/sched/preempt"
_GOOD_CLOCKS = ("tsc", "arch_sys_counter")
_SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies")
_MODES = ("none", "voluntary", "lazy", "full")


def examine() -> list[Finding]:
    """As the kernel tells; nothing is measured."""
    return [_preemption(), _governor(), _idle(), _isolated(), _clock(), _throttling()]


def _preemption() -> Finding:
    name, kernel = "kernel preemption", platform.release()
    if read("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version():
        return Finding(name, f"PREEMPT_RT, {kernel}")
    mode, source = _preemption_mode()
    remedy = "sudo apt install linux-image-rt-amd64   # or boot with preempt=full"
    if mode == "full":
        return Finding(name, f"full, not PREEMPT_RT ({source}), {kernel}", Verdict.BETTER, remedy)
    return Finding(name, f"{mode} ({source}), {kernel}", Verdict.BETTER, remedy)


def _preemption_mode() -> tuple[str, str]:
    """What is known of it, and from where."""
    chosen = read(_PREEMPT)
    if chosen and "(" in chosen:
        return chosen.split("(", 1)[1].split(")", 1)[0], "now"
    for word in (read("/proc/cmdline") or "").split():
        if word.startswith("preempt="):
            return word.removeprefix("preempt="), "boot command"
    build = _build()
    for mode in _MODES:
        key = "CONFIG_PREEMPT=y" if mode == "full" else f"CONFIG_PREEMPT_{mode.upper()}=y"
        if key in build:
            return mode, "the kernel's default"
    return "unknown", "not reported by the kernel"


def _build() -> set[str]:
    """Lines of the configuration the kernel was built with; empty where it is not to be had."""
    try:
        with gzip.open("/proc/config.gz", "rt", encoding="utf-8") as file:
            return set(file.read().splitlines())
    except OSError:
        return set((read(f"/boot/config-{platform.release()}") or "").splitlines())


def _governor() -> Finding:
    name = "frequency governor"
    found = {read(path) for path in _CPU.glob("cpu[0-9]*/cpufreq/scaling_governor")}
    if not found:
        return Finding(name, "none to be seen, as in most virtual machines")
    text = ", ".join(sorted(governor or "unreadable" for governor in found))
    if found == {"performance"}:
        return Finding(name, text)
    return Finding(name, text, Verdict.BETTER, "sudo cpupower frequency-set --governor performance")


def _idle() -> Finding:
    name, latencies = "idle states", []
    for state in sorted(_CPU.glob("cpu0/cpuidle/state[0-9]*")):
        latency = read(state / "latency")
        latencies.append((int(latency) if latency else 0, read(state / "name") or state.name))
    if not latencies:
        return Finding(name, "none to be seen")
    deepest, title = max(latencies)
    return Finding(name, f"up to {title}, {deepest} us to wake; held off while the daemon runs")


def _isolated() -> Finding:
    count, isolated = os.cpu_count() or 1, read(_CPU / "isolated")
    name, last = "isolated processors", count - 1
    if isolated:
        return Finding(name, f"{isolated} of {count}")
    remedy = f"boot with isolcpus={last} nohz_full={last}, and set realtime.daemon_cpu: {last}"
    return Finding(name, f"none of {count}", Verdict.BETTER, remedy)


def _clock() -> Finding:
    name, present = "clock source", read(_CLOCK / "current_clocksource") or "unknown"
    if present in _GOOD_CLOCKS:
        return Finding(name, present)
    verdict = Verdict.BAD if present in _SLOW_CLOCKS else Verdict.BETTER
    if "tsc" in (read(_CLOCK / "available_clocksource") or "").split():
        return Finding(name, present, verdict, f"echo tsc | sudo tee {_CLOCK}/current_clocksource")
    return Finding(name, f"{present}, and no tsc", verdict, "boot with tsc=reliable")


def _throttling() -> Finding:
    """Both keep a share of every second from real-time tasks that would use all of it: a defect of
    ours then costs a gap of that length and not the machine."""
    name = "real-time throttling"
    runtime = int(read("/proc/sys/kernel/sched_rt_runtime_us") or -1)
    period = int(read("/proc/sys/kernel/sched_rt_period_us") or 1_000_000)
    if runtime < 0:
        return Finding(name, "off")
    percent = 100.0 * runtime / period
    return Finding(name, f"above {percent:.0f} % of a processor; the daemon uses less")
