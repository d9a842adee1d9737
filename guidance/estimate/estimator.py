"""One state at one instant, from attitude and position that were measured at others.

Both samples are kept with the instant of their measurement, on the companion's clock. The vehicle is taken
to keep its twist: the newest attitude is turned to the instant of the newest position by the body rates,
the velocity is seen from there, and the pose moves on along that constant twist to the instant asked for, or
as the setpoints say that act until then.
A sample that is not finite, not newer than the one before of its kind, or not from a plausible instant is
refused under a name and changes nothing.

Sources of one flight differ by centimetres and parts of a degree. When another one takes over, that
difference is kept as an offset that dies away, so that no setpoint sees a step. A difference too large for
that is the estimator's jump, and is taken at once, as every reset is: the vehicle is where it says.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from guidance.estimate.origin import LocalOrigin
from guidance.estimate.resets import (
    ATTITUDE_JUMP_RAD,
    POSITION_JUMP_M,
    Reset,
    attitude_jumped,
    moved,
    position_jumped,
    turned,
)
from guidance.estimate.samples import (
    AttitudeSample,
    PositionSample,
    from_euler_angles,
    from_global,
    from_local,
    from_odometry,
    from_quaternion,
    within_step,
)
from guidance.estimate.sources import ATTITUDES, POSITIONS, Choice, Source, Switch
from guidance.geodesy import Projection
from guidance.mavlink.messages import (
    Attitude,
    AttitudeQuaternion,
    GpsGlobalOrigin,
    LocalPositionNed,
    Odometry,
    StateBody,
)
from guidance.prediction import NOTHING_SENT, History, predict
from guidance.se3 import (
    ZERO,
    Pose,
    Quaternion,
    Twist,
    Vec3,
    add,
    conjugate,
    multiply,
    norm,
    quaternion_exp,
    quaternion_log,
    rotate,
    rotate_inverse,
    scale,
    subtract,
)

#: The offset of a switch falls to 1/e in this time.
BLEND_TIME_S: Final = 1.0
#: The largest offset, in jumps: what is no jump across a gap of 0.2 s is less.
BLEND_MAX: Final = 2.0
#: After so many of these times nothing is left of it (1 m: 45 um).
_BLEND_TIMES: Final = 10.0


class Estimate(NamedTuple):
    """The state at `instant_ns` and the ages (s, at that instant) of what it was made from.

    `resets` counts those of the autopilot's estimator. `offset_m` is how far the position still is from what
    its source says, since a switch of sources. `seen` is the pose that `pose` was predicted from,
    `position_age_s` before, at which `position` gives the velocity, and `history` the setpoints that it was
    predicted with: for those who predict otherwise, or to another instant.
    """

    instant_ns: int
    pose: Pose
    twist: Twist
    attitude: AttitudeSample
    position: PositionSample
    attitude_age_s: float
    position_age_s: float
    seen: Pose
    resets: int = 0
    offset_m: float = 0.0
    history: History = NOTHING_SENT

    @property
    def velocity_ned_m_s(self) -> Vec3:
        """The velocity in NED, m/s."""
        return rotate(self.pose.attitude, self.twist.linear)

    def attitude_at(self, instant_ns: int) -> Quaternion:
        """What the autopilot will take its attitude to be: its own last one, without any offset, turned on as
        it was measured and as the setpoints say that act until then."""
        sample = self.attitude
        pose, twist = Pose(ZERO, sample.attitude), Twist(sample.body_rates_frd_rad_s, ZERO)
        return predict(self.history, pose, twist, sample.instant_ns, instant_ns)[0].attitude


class Estimator:
    """Keeps the newest usable samples of the best source; `news` is what happened, for the owner to clear."""

    def __init__(self, project: Projection) -> None:
        self.resets = 0
        self.news: list[Reset | Switch] = []
        self.origin = LocalOrigin(project)
        self._project = project
        self._attitudes: Choice[AttitudeSample] = Choice(ATTITUDES)
        self._positions: Choice[PositionSample] = Choice(POSITIONS)
        self._reset_counter: int | None = None
        self._forget_offset()

    @property
    def attitude(self) -> AttitudeSample | None:
        """The newest attitude in use."""
        return self._attitudes.newest

    @property
    def position(self) -> PositionSample | None:
        """The newest position in use."""
        return self._positions.newest

    def reset(self) -> None:
        """Forget everything: the autopilot rebooted."""
        self._attitudes.reset()
        self._positions.reset()
        self._reset_counter = None
        self.origin.reset()
        self._forget_offset()

    def take(
        self, message: StateBody, instant_ns: int, now_ns: int, origin: GpsGlobalOrigin | None = None
    ) -> str | None:
        """Whichever it is, measured at `instant_ns`; `origin` is what GLOBAL_POSITION_INT counts from,
        unless one is held.

        None if it is used from now on, "not_needed" if a better source is, else why it was refused.
        """
        attitudes, positions = self._attitudes, self._positions
        if isinstance(message, Odometry):
            return self._take_odometry(message, instant_ns, now_ns)
        if isinstance(message, AttitudeQuaternion):
            source = attitudes.sources["ATTITUDE_QUATERNION"]
            if attitudes.needs(source, instant_ns):
                return self._take_attitude(source, from_quaternion(message, instant_ns), now_ns)
        elif isinstance(message, Attitude):
            source = attitudes.sources["ATTITUDE"]
            if attitudes.needs(source, instant_ns):
                return self._take_attitude(source, from_euler_angles(message, instant_ns), now_ns)
        elif isinstance(message, LocalPositionNed):
            source = positions.sources["LOCAL_POSITION_NED"]
            if positions.needs(source, instant_ns):
                return self._take_position(source, from_local(message, instant_ns), now_ns)
        else:
            source = positions.sources["GLOBAL_POSITION_INT"]
            if positions.needs(source, instant_ns):
                sample = from_global(message, instant_ns, self.origin.held or origin, self._project)
                if positions.newest is not None and not isinstance(sample, str):
                    sample = within_step(positions.newest, sample)
                return self._take_position(source, sample, now_ns)
        return "not_needed"

    def _take_odometry(self, message: Odometry, instant_ns: int, now_ns: int) -> str | None:
        attitudes, positions = self._attitudes, self._positions
        of_attitude, of_position = attitudes.sources["ODOMETRY"], positions.sources["ODOMETRY"]
        samples = from_odometry(message, instant_ns)
        if isinstance(samples, str):
            return samples
        attitude, position = samples
        refused = of_attitude.refuse_time(attitude, now_ns)
        if refused is not None:
            return refused
        in_use = attitudes.uses(of_attitude) and positions.uses(of_position)
        counted = in_use and message.reset_counter != self._reset_counter
        self._reset_counter = message.reset_counter
        takes_attitude = attitudes.takes(of_attitude, attitude)
        takes_position = positions.takes(of_position, position)
        if not (takes_attitude or takes_position):
            return "not_needed"
        self._use(attitude if takes_attitude else None, position if takes_position else None, counted)
        return None

    def _take_attitude(self, source: Source, sample: AttitudeSample | str, now_ns: int) -> str | None:
        refused = sample if isinstance(sample, str) else source.refuse_time(sample, now_ns)
        if isinstance(sample, str) or refused is not None:
            source.fail()
            return refused
        if not self._attitudes.takes(source, sample):
            return "not_needed"
        self._use(sample, None)
        return None

    def _take_position(self, source: Source, sample: PositionSample | str, now_ns: int) -> str | None:
        refused = sample if isinstance(sample, str) else source.refuse_time(sample, now_ns)
        if isinstance(sample, str) or refused is not None:
            source.fail()
            return refused
        if not self._positions.takes(source, sample):
            return "not_needed"
        self._use(None, sample)
        return None

    def _use(
        self, attitude: AttitudeSample | None, position: PositionSample | None, counted: bool = False
    ) -> None:
        """Go on from these; say what changed with them beyond the vehicle's motion."""
        before = (self._attitudes.newest, self._positions.newest)
        jumped = switched = False
        if attitude is not None and before[0] is not None:
            jumped = attitude_jumped(before[0], attitude)
            switched = before[0].source != attitude.source
        if position is not None and before[1] is not None:
            jumped = position_jumped(before[1], position) or jumped
            switched = switched or before[1].source != position.source
        newest = attitude or position
        assert newest is not None
        predicted = self.at(newest.instant_ns) if switched else None
        if attitude is not None:
            self._attitudes.use(self._attitudes.sources[attitude.source], attitude)
        if position is not None:
            self._positions.use(self._positions.sources[position.source], position)
        if switched:
            self._tell_switch(before[0], attitude, "attitude")
            self._tell_switch(before[1], position, "position")
        if jumped or counted:
            cause = "counter" if counted else "switch" if switched else "jump"
            self._found_reset(before, attitude, position, cause)
        elif predicted is not None:
            self._keep_offset(predicted)

    def _tell_switch(
        self,
        before: AttitudeSample | PositionSample | None,
        after: AttitudeSample | PositionSample | None,
        quantity: str,
    ) -> None:
        if before is not None and after is not None and before.source != after.source:
            self.news.append(Switch(after.instant_ns, quantity, before.source, after.source))

    def _found_reset(
        self,
        before: tuple[AttitudeSample | None, PositionSample | None],
        attitude: AttitudeSample | None,
        position: PositionSample | None,
        cause: str,
    ) -> None:
        self.resets += 1
        newest = attitude or position
        assert newest is not None
        turn = ZERO if attitude is None or before[0] is None else turned(before[0], attitude)
        move = ZERO if position is None or before[1] is None else moved(before[1], position)
        self.news.append(Reset(newest.instant_ns, newest.source, cause, move, turn))
        self._forget_offset()

    # Offsets -----------------------------------------------------------------------------------------

    def _forget_offset(self) -> None:
        self._offset_ned_m: Vec3 | None = None
        self._offset_ned_rad = ZERO
        self._offset_ns = 0

    def _keep_offset(self, predicted: Estimate) -> None:
        """Go on from where the sources before would have been."""
        self._forget_offset()
        said = self.at(predicted.instant_ns)
        assert said is not None
        apart_m = subtract(predicted.pose.position, said.pose.position)
        apart_rad = quaternion_log(multiply(predicted.pose.attitude, conjugate(said.pose.attitude)))
        # What is larger, though no jump, comes from predicting across a gap: nothing to hold on to.
        self._offset_ned_m = apart_m if norm(apart_m) <= BLEND_MAX * POSITION_JUMP_M else ZERO
        self._offset_ned_rad = apart_rad if norm(apart_rad) <= BLEND_MAX * ATTITUDE_JUMP_RAD else ZERO
        self._offset_ns = predicted.instant_ns

    # The state ---------------------------------------------------------------------------------------

    def at(self, instant_ns: int, history: History = NOTHING_SENT) -> Estimate | None:
        """The state at `instant_ns`; None until there are both an attitude and a position.

        `history` is of setpoints that the vehicle obeys (`guidance.prediction`).

        Whether it is young enough to be used is the caller's decision, by the ages.
        """
        attitude, position = self._attitudes.newest, self._positions.newest
        if attitude is None or position is None:
            return None
        q, x, offset_m = attitude.attitude, position.position_ned_m, 0.0
        if self._offset_ned_m is not None:
            times = max((instant_ns - self._offset_ns) * 1e-9 / BLEND_TIME_S, 0.0)
            if times < _BLEND_TIMES:
                left = math.exp(-times)
                offset_m = left * norm(self._offset_ned_m)
                x = add(x, scale(left, self._offset_ned_m))
                q = multiply(quaternion_exp(scale(left, self._offset_ned_rad)), q)
        rates = attitude.body_rates_frd_rad_s
        back_s = (position.instant_ns - attitude.instant_ns) * 1e-9
        at_position = multiply(q, quaternion_exp(scale(back_s, rates)))
        twist = Twist(rates, rotate_inverse(at_position, position.velocity_ned_m_s))
        ahead_s = (instant_ns - position.instant_ns) * 1e-9
        seen = Pose(x, at_position)
        pose, twist = predict(history, seen, twist, position.instant_ns, instant_ns)
        return Estimate(
            instant_ns=instant_ns,
            pose=pose,
            twist=twist,
            attitude=attitude,
            position=position,
            attitude_age_s=(instant_ns - attitude.instant_ns) * 1e-9,
            position_age_s=ahead_s,
            seen=seen,
            resets=self.resets,
            offset_m=offset_m,
            history=history,
        )
