"""Deliberate bugs in law, limiter and envelope, one at a time: each must break the property named
beside it, and the code as it is must break none.

A mutation is a replacement in the module's source, run as a module of its own; where the source no
longer has the line, the mutation has to be written anew.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest

import tonus.runtime.control.passivity
import tonus.runtime.control.stiffness
import tonus.runtime.safety.envelope
from tonus.config import load
from tonus.runtime.signals import Bound, Grade
from tonus.runtime.states import Fault

CONFIG, _ = load("config/can.yaml")
ROBOT, CONTROL = CONFIG.robot, CONFIG.control
LAW, TANK, SETTINGS, TENSION = (
    CONTROL.stiffness,
    CONTROL.passivity,
    CONTROL.envelope,
    CONTROL.tension,
)
PERIOD, RATIO, MASS = CONTROL.rates.period, CONTROL.impedance.damping_ratio, ROBOT.platform.mass
ZERO, ALL = np.zeros(3), np.ones(8, dtype=bool)


# --- the law -------------------------------------------------------------------------------------


def law_is_equation_3(module: ModuleType) -> None:
    law = module.Law(LAW)
    assert law(0.5, 0.095, 12.5) == pytest.approx(3210.0 * (1.0 + 0.16 + 0.09))
    assert law(0.0, 0.19, 0.0) == pytest.approx(3210.0 * 1.32)


def law_is_equation_10(module: ModuleType) -> None:
    law = module.Law(LAW.model_copy(update={"profile": "eq10", "deviation_gain": 0.32}))
    assert law(0.015, 0.0, 0.0) == pytest.approx(3210.0 * 1.16)


def law_keeps_its_bounds(module: ModuleType) -> None:
    steep = LAW.model_copy(update={"force_gain": 5.0})
    assert module.Law(steep)(1.0, 1.0, 1e3) == LAW.maximum
    assert module.Law(LAW.model_copy(update={"base": 100.0}))(0.0, 0.0, 0.0) == LAW.minimum


def law_saturates(module: ModuleType) -> None:
    law = module.Law(LAW)
    assert law(0.0, 9.0, 900.0) == pytest.approx(3210.0 * 1.5)
    assert law(0.0, 0.0, 900.0) == pytest.approx(3210.0 * 1.18)


# --- the limiter ---------------------------------------------------------------------------------


def limiter_of(module: ModuleType, ratio: float = RATIO, **changes: float) -> Any:
    return module.Limiter(LAW.model_copy(update=changes), TANK, ROBOT, ratio, PERIOD)


def limiter_keeps_bounds_and_cap(module: ModuleType) -> None:
    limiter = limiter_of(module)
    for _ in range(3000):
        assert limiter(1e9, 1e9, ZERO, ZERO, ZERO) <= LAW.maximum
    assert limiter(4000.0, 900.0, ZERO, ZERO, ZERO) == 900.0
    assert limiter(0.0, 1e9, ZERO, ZERO, ZERO) == LAW.minimum
    assert limiter(math.nan, 1e9, ZERO, ZERO, ZERO) == LAW.minimum


def limiter_keeps_the_rate_bound(module: ModuleType) -> None:
    """K' + alpha D' <= 2 alpha K, with alpha from figures of its own."""
    alpha = (
        2.0
        * RATIO
        * math.sqrt(LAW.minimum * MASS)
        / tonus.runtime.control.passivity.felt_inertia(ROBOT)
    )
    limiter = limiter_of(module)
    for _ in range(3000):
        before = limiter.value
        now = limiter(1e9, 1e9, ZERO, ZERO, ZERO)
        resisting = 2.0 * RATIO * math.sqrt(MASS) * (math.sqrt(now) - math.sqrt(before))
        assert now - before + alpha * resisting <= 2.0 * alpha * before * PERIOD + 1e-6
    assert now == LAW.maximum, "and gets there"


def limiter_falls_at_once(module: ModuleType) -> None:
    limiter = limiter_of(module)
    for _ in range(3000):
        limiter(4000.0, 1e9, ZERO, ZERO, ZERO)
    assert limiter(LAW.minimum, 1e9, ZERO, ZERO, ZERO) == LAW.minimum


def storage_and_tank_never_grow(module: ModuleType) -> None:
    """Mass, spring and damper alone, stiffened on the way in and softened on the way out, and the
    other way round, the tank at its bounds more than once."""
    for stiffer_inward in (True, False):
        ratio, e, v, fine = 0.05, 0.08, 0.0, 50
        limiter = limiter_of(module, ratio, rise_rate=1e9)
        limiter(LAW.minimum, 1e9, np.array([e, 0.0, 0.0]), ZERO, ZERO)
        total = 0.5 * limiter.value * e * e + limiter.tank.level
        for _ in range(1500):
            resisting = 2.0 * ratio * math.sqrt(limiter.value * MASS)
            for _ in range(fine):
                v -= PERIOD / fine * (limiter.value * e + resisting * v) / MASS
                e += PERIOD / fine * v
            wanted = LAW.maximum if (e * v < 0.0) is stiffer_inward else LAW.minimum
            limiter(wanted, 1e9, np.array([e, 0.0, 0.0]), np.array([v, 0.0, 0.0]), ZERO)
            assert TANK.tank_minimum <= limiter.tank.level <= TANK.tank_capacity
            now = 0.5 * MASS * v * v + 0.5 * limiter.value * e * e + limiter.tank.level
            assert now <= total * (1.0 + 1e-4)
            total = now


def falling_gives_back_no_more_than_it_took(module: ModuleType) -> None:
    limiter, stretch = limiter_of(module), np.array([0.005, 0.0, 0.0])
    for _ in range(300):
        limiter(700.0, 1e9, stretch, ZERO, ZERO)
    level, high = limiter.tank.level, limiter.value
    limiter(LAW.minimum, 1e9, stretch, ZERO, ZERO)
    assert high > LAW.minimum + 100.0
    assert 0.0 < limiter.tank.level - level <= 0.5 * (high - LAW.minimum) * 0.005**2


def limiter_starts_soft_again(module: ModuleType) -> None:
    limiter = limiter_of(module)
    for _ in range(300):
        limiter(4000.0, 1e9, np.array([0.01, 0.0, 0.0]), ZERO, ZERO)
    limiter.reset()
    assert (limiter.value, limiter.tank.level) == (LAW.minimum, TANK.tank_initial)
    limiter(LAW.minimum, 1e9, np.array([0.2, 0.0, 0.0]), ZERO, ZERO)
    assert limiter.tank.level == TANK.tank_initial, "a new start is no motion"


# --- the envelope --------------------------------------------------------------------------------


def envelope_of(module: ModuleType, **changes: Any) -> Any:
    return module.Envelope(SETTINGS.model_copy(update=changes), TENSION, LAW, ROBOT, PERIOD)


def feed(e: Any, contact: float = 0.0, ticks: int = 2, **changes: Any) -> Any:
    tension = np.broadcast_to(changes.get("tension", 45.0), 8).astype(float)
    position, velocity = (np.array(changes.get(n, ZERO), float) for n in ("position", "velocity"))
    for _ in range(ticks):
        e(tension.copy(), contact, position, velocity, changes.get("bearing", ALL))
    return e


def contact_softens_before_it_stops(module: ModuleType) -> None:
    assert feed(envelope_of(module), 19.0).cap == LAW.maximum
    amber = feed(envelope_of(module), 22.0)
    assert (amber.grade, amber.bound, amber.fault) == (Grade.AMBER, Bound.CONTACT, Fault.NONE)
    assert LAW.minimum < amber.cap < LAW.maximum
    assert 0.0 < amber.progress < 1.0
    assert feed(envelope_of(module), 22.0, ticks=1).progress == amber.progress, "at once"
    assert feed(envelope_of(module), 23.8).cap == LAW.minimum
    assert feed(envelope_of(module), 24.9).fault is Fault.NONE
    assert feed(envelope_of(module), 25.0).fault is Fault.CONTACT_LIMIT


def contact_is_predicted(module: ModuleType) -> None:
    e = envelope_of(module)
    for n in range(33):
        feed(e, 0.3 * n, ticks=1)
    assert e.cap == LAW.minimum
    for n in range(33, 10, -1):
        feed(e, 0.3 * n, ticks=1)
    assert e.contact == pytest.approx(1.0 - 3.3 / 25.0), "a falling force is not counted as less"


def softness_has_hysteresis(module: ModuleType) -> None:
    e = feed(envelope_of(module), 22.0)
    cap = e.cap
    assert feed(e, 21.5, ticks=300).cap == cap
    before = feed(e, 23.0).progress
    for _ in range(2000):
        assert feed(e, 5.0, ticks=1).progress - before <= SETTINGS.release_rate * PERIOD + 1e-12
        before = e.progress
    assert e.progress == 1.0
    pressed = feed(envelope_of(module), 23.4)
    low = pressed.progress
    assert low < feed(pressed, 21.0, ticks=2000).progress < 1.0, "as far as there is room"


def speed_and_place_slow_but_do_not_soften(module: ModuleType) -> None:
    fast = feed(envelope_of(module), velocity=(0.0, 0.23, 0.0))
    assert (fast.bound, fast.cap) == (Bound.SPEED, LAW.maximum)
    assert 0.0 < fast.progress < 1.0
    assert feed(envelope_of(module), velocity=(0.2, 0.15, 0.0)).fault is Fault.SPEED_LIMIT
    edge = ROBOT.workspace.z[0]
    near = feed(envelope_of(module), position=(0, 0, edge + 0.015), velocity=(0, 0, -0.2))
    assert (near.bound, near.fault) == (Bound.WORKSPACE, Fault.NONE)
    beyond = feed(envelope_of(module), position=(0, 0, edge - 0.001))
    assert beyond.fault is Fault.WORKSPACE_LIMIT


def tension_bounds_count_ticks_and_cables(module: ModuleType) -> None:
    ticks, slack = SETTINGS.over_tension_ticks, np.full(8, 45.0)
    slack[3] = TENSION.slack - 1.0
    assert feed(envelope_of(module), tension=slack, ticks=ticks - 1).fault is Fault.NONE
    e = feed(envelope_of(module), tension=slack, ticks=ticks)
    assert (e.fault, e.where) == (Fault.SLACK_CABLE, 3)
    assert feed(envelope_of(module), tension=slack, ticks=50, bearing=~ALL).fault is Fault.NONE
    tight = np.full(8, 45.0)
    tight[6] = TENSION.max - 2.0
    high = feed(envelope_of(module), tension=tight, ticks=50)
    assert (high.bound, high.fault) == (Bound.TENSION_HIGH, Fault.NONE)
    assert high.cap < LAW.maximum
    tight[6] = TENSION.max + 1.0
    e = feed(envelope_of(module), tension=tight, ticks=ticks)
    assert (e.fault, e.where) == (Fault.OVER_TENSION, 6)


def tension_is_predicted(module: ModuleType) -> None:
    e = feed(envelope_of(module), tension=150.0)
    assert e.grade is Grade.GREEN
    assert feed(e, tension=151.0, ticks=1).bound is Bound.TENSION_HIGH


class Mutation(NamedTuple):
    module: ModuleType
    old: str
    new: str
    caught_by: Callable[[ModuleType], None]


LAW_CODE, LIMITER, ENVELOPE = (
    tonus.runtime.control.stiffness,
    tonus.runtime.control.passivity,
    tonus.runtime.safety.envelope,
)
MUTATIONS = (
    Mutation(LAW_CODE, "velocity_gain * min", "force_gain * min", law_is_equation_3),
    Mutation(LAW_CODE, "velocity / c.velocity", "velocity * c.velocity", law_is_equation_3),
    Mutation(LAW_CODE, "terms.velocity + terms.force", "terms.velocity", law_is_equation_3),
    Mutation(LAW_CODE, '== "eq10"', '!= "eq10"', law_is_equation_10),
    Mutation(LAW_CODE, "min(force / c.force_reference, 1.0)", "force / 25.0", law_saturates),
    Mutation(LAW_CODE, "c.minimum), c.maximum", "c.minimum), math.inf", law_keeps_its_bounds),
    Mutation(LAW_CODE, "max(c.base * (1.0 + rise), c.minimum)", "c.base * (1.0 + rise)",
             law_keeps_its_bounds),
    Mutation(LIMITER, "min(wanted, cap, maximum)", "min(wanted, maximum)",
             limiter_keeps_bounds_and_cap),
    Mutation(LIMITER, "min(wanted, cap, maximum)", "max(wanted, cap)",
             limiter_keeps_bounds_and_cap),
    Mutation(LIMITER, "if not target >= minimum", "if target < minimum",
             limiter_keeps_bounds_and_cap),
    Mutation(LIMITER, "before + period * bound",
             "math.inf", limiter_keeps_the_rate_bound),
    Mutation(LIMITER, "2.0 * alpha * stiffness /", "4.0 * alpha * stiffness /",
             limiter_keeps_the_rate_bound),
    Mutation(LIMITER, "stiffness / (1.0 + spread)", "stiffness", limiter_keeps_the_rate_bound),
    Mutation(LIMITER, "/ felt_inertia(robot)", "/ robot.platform.mass",
             limiter_keeps_the_rate_bound),
    Mutation(LIMITER, "if target > before:", "if target != before:", limiter_falls_at_once),
    Mutation(LIMITER, "paid, stored = _admit(stored, empty, before, min(target, highest), stretch)",
             "paid = min(target, highest)", storage_and_tank_never_grow),
    Mutation(LIMITER, "0.5 * (wanted - stiffness) *", "0.1 * (wanted - stiffness) *",
             storage_and_tank_never_grow),
    Mutation(LIMITER, "level - cost", "level", storage_and_tank_never_grow),
    Mutation(LIMITER, "min(capacity, level + efficiency * energy)",
             "level + efficiency * energy", storage_and_tank_never_grow),
    Mutation(LIMITER, "resistance * step", "5.0 * resistance * step", storage_and_tank_never_grow),
    Mutation(LIMITER, "(error[k] - last[k]) ** 2", "(error[k] + last[k]) ** 2",
             storage_and_tank_never_grow),
    Mutation(LIMITER, "stretch += error[k] ** 2", "stretch += abs(error[k])",
             falling_gives_back_no_more_than_it_took),
    Mutation(LIMITER, "0.5 * (before - target) * stretch", "2.0 * (before - target) * stretch",
             falling_gives_back_no_more_than_it_took),
    Mutation(LIMITER, "        self.tank.reset()\n", "", limiter_starts_soft_again),
    Mutation(LIMITER, "        self._followed = False\n", "        self._followed = True\n",
             limiter_starts_soft_again),
    Mutation(ENVELOPE, "contact >= s.contact_limit", "contact > 2.0 * s.contact_limit",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "s.contact_limit * s.contact_warning", "0.9 * s.contact_limit",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "s.contact_limit * (1.0 - s.hysteresis)", "s.contact_limit",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "low + share * (high - low)", "high - share * (high - low)",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "self.progress = share", "self.progress = 1.0",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "contact + horizon * swell)", "contact)", contact_is_predicted),
    Mutation(ENVELOPE, "max(contact, contact + horizon * swell)",
             "contact + horizon * swell", contact_is_predicted),
    Mutation(ENVELOPE, "elif left[i] - band > held[i]", "elif left[i] > held[i]",
             softness_has_hysteresis),
    Mutation(ENVELOPE, ", held[i] + release)", ")", softness_has_hysteresis),
    Mutation(ENVELOPE, "elif left[i] - band > held[i]", "elif left[i] - band > 1.0",
             softness_has_hysteresis),
    Mutation(ENVELOPE, "if held[i] < held[least]", "if held[i] > held[least]",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "held[i] = max(left[i], 0.0)", "held[i] = 0.0",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "bound in (_CONTACT, _TENSION_HIGH)", "bound in tuple(Bound)",
             speed_and_place_slow_but_do_not_soften),
    Mutation(ENVELOPE, "if stiffening else high", "if not stiffening else high",
             contact_softens_before_it_stops),
    Mutation(ENVELOPE, "speed >= s.speed_limit", "speed >= 2.0 * s.speed_limit",
             speed_and_place_slow_but_do_not_soften),
    Mutation(ENVELOPE, "position[i] + horizon * velocity[i]", "position[i]",
             speed_and_place_slow_but_do_not_soften),
    Mutation(ENVELOPE, "then, ahead - low[i], high", "then, high",
             speed_and_place_slow_but_do_not_soften),
    Mutation(ENVELOPE, "elif over >= ticks", "elif over > ticks",
             tension_bounds_count_ticks_and_cables),
    Mutation(ENVELOPE, "int(self._under.argmax())", "0", tension_bounds_count_ticks_and_cables),
    Mutation(ENVELOPE, "bearing[i] and tension[i] < slack", "tension[i] < slack",
             tension_bounds_count_ticks_and_cables),
    Mutation(ENVELOPE, "tension_high / edge", "math.inf",
             tension_bounds_count_ticks_and_cables),
    Mutation(ENVELOPE, "tension[i] + reach * (tension[i] - last[i])", "tension[i]",
             tension_is_predicted),
)  # fmt: skip


def variant(module: ModuleType, old: str = "", new: str = "") -> ModuleType:
    """The module with a line changed, run without compiling."""
    source = inspect.getsource(module).replace("@njit(cache=True)\n", "")
    if old:
        assert source.count(old) == 1, f"{old!r} stands {source.count(old)} times in the source"
        source = source.replace(old, new)
    changed = ModuleType(f"{module.__name__}_changed")
    changed.__dict__["math"] = math
    sys.modules[changed.__name__] = changed
    exec(compile(source, changed.__name__, "exec"), changed.__dict__)  # noqa: S102
    return changed


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: f"{m.old.strip()} -> {m.new.strip()}")
def test_each_deliberate_bug_is_caught(mutation: Mutation) -> None:
    changed = variant(mutation.module, mutation.old, mutation.new)
    with pytest.raises(AssertionError):
        mutation.caught_by(changed)


def test_the_code_as_it_is_passes_every_property_that_catches_a_bug() -> None:
    for module in (LAW_CODE, LIMITER, ENVELOPE):
        same = variant(module)
        for holds in {m.caught_by for m in MUTATIONS if m.module is module}:
            holds(same)
