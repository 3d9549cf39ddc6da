"""The guard, whatever comes in whatever order: commands, samples, ticks, resets."""

import fuzz
from firmware_checks import four_wires
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from hardware.firmware import guard, heat

DUTY = st.one_of(st.floats(0.0, 1.0), st.sampled_from([0.0, 1.0, 1.1, -0.1]))
READING = st.one_of(
    st.floats(20.0, 30.0), st.floats(-270.0, 1800.0), st.just(None), st.just(None), st.just(None)
)
SHARES = ((-1.0, 1.0),)
REASONS = st.sampled_from([guard.POWER_UP, guard.RESET, guard.RESTARTED, guard.BEND_STUCK])


class GuardMachine(RuleBasedStateMachine):
    """A guard and a limb of two nominal wires, whose readings may be anything."""

    @initialize(challenge=st.integers(0, 0xFFFF), reason=REASONS)
    def switch_on(self, challenge, reason):
        self.now = 0
        self.guard = guard.Guard(0, challenge, reason)
        self.temperatures, self.bend = [25.0, 25.0], 0
        self.was_hot_at_start = reason != guard.POWER_UP
        self.latched = reason if reason >= guard.LATCHING else None

    @rule(
        challenge=st.one_of(st.just(None), st.just(None), st.integers(0, 0xFFFF)),
        total=st.sampled_from([1.0, 0.5, 2.0, 2.5, 0.0]),
        number=st.integers(0, 4),
        factor=st.sampled_from([1.0, 1.0, 1.0, 0.9, 1.1, 0.1, 10.0]),
    )
    def arm(self, challenge, total, number, factor):
        bounds = list(heat.NOMINAL)
        bounds[number] *= factor
        right = self.guard.challenge if challenge is None else challenge
        before = self.guard.reason
        self.guard.arm(right, (tuple(bounds), heat.NOMINAL), total, SHARES, self.now)
        assert self.guard.state == guard.DISARMED or before < guard.LATCHING

    @rule(
        step=st.sampled_from([1, 1, 1, 0, -1, 5]),
        age=st.one_of(st.integers(0, 100), st.integers(-(2**31), 2**31)),
        duty=st.tuples(DUTY, DUTY),
        stray=st.booleans(),
    )
    def command(self, step, age, duty, stray):
        session = (self.guard.session or 0) ^ (stray and duty[0] > 0.9)
        heard = (self.now - age) & 0xFFFFFFFF
        self.guard.command(session, self.guard.acknowledged + step, heard, duty, self.now)

    @rule(milliseconds=st.one_of(st.integers(1, 60), st.integers(0, 10_000)))
    def wait(self, milliseconds):
        self.now += milliseconds
        self.guard.tick(self.now)

    @rule(
        readings=st.tuples(READING, READING),
        faults=st.tuples(*2 * [st.sampled_from([0] * 8 + [1, 2, 4, 8])]),
        silent=st.sampled_from([False] * 9 + [True]),
    )
    def sample(self, readings, faults, silent):
        self._sample(readings, faults, silent)

    @rule(duty=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), count=st.integers(1, 60))
    def heat(self, duty, count):
        """As a host does it: armed, commanded, sampled each 50 ms."""
        bounds = heat.NOMINAL, heat.NOMINAL
        self.guard.arm(self.guard.challenge, bounds, 2.0, SHARES, self.now)
        for _ in range(count):
            sequence = self.guard.acknowledged + 1
            self.guard.command(self.guard.session, sequence, self.now, duty, self.now)
            self.guard.tick(self.now)
            self.now += 50
            self._sample((None, None), (0, 0), False)
            self.guard.tick(self.now)
            fuzz.check_guard(self.guard, self.now)

    def _sample(self, readings, faults, silent):
        for wire in (0, 1):
            warming = 20.0 * self.guard.duty[wire] - 0.07 * (self.temperatures[wire] - 25.0)
            self.temperatures[wire] += 0.05 * warming
        self.bend = (self.bend + 1) % 7
        shown = [
            there if reading is None else reading
            for reading, there in zip(readings, self.temperatures, strict=True)
        ]
        bend = None if silent else [self.bend]
        self.guard.sample(self.now, shown, [26.0, 26.0], list(faults), bend)

    @rule()
    def disarm(self):
        self.guard.disarm(self.now)
        assert self.guard.duty == [0.0, 0.0]

    @rule(right=st.booleans())
    def clear(self, right):
        before = self.guard.reason
        self.guard.clear(self.guard.challenge ^ (not right))
        if right:
            self.latched = None
        else:
            assert self.guard.reason == before

    @invariant()
    def there_is_duty_only_if_armed_fresh_and_in_band(self):
        if hasattr(self, "guard"):
            fuzz.check_guard(self.guard, self.now)

    @invariant()
    def a_latch_stays_until_it_is_cleared(self):
        if hasattr(self, "guard"):
            if self.latched:
                assert self.guard.reason == self.latched
            if self.guard.reason >= guard.LATCHING:
                self.latched = self.guard.reason


TestGuard = GuardMachine.TestCase
TestGuard.settings = settings(
    max_examples=60, stateful_step_count=40, deadline=None, derandomize=True
)


def test_frames_of_the_present_session():
    """To boards with two wires, and with four that bend about two axes."""
    for board in (None, four_wires().board):
        counts = fuzz.fuzz_guard(10_000, seed=1, paper=board)
        assert counts["steps with duty"] > 500
        assert counts["steps latched"] > 300
        assert counts["resets"] >= 1
