"""A world: simulations of several kinds that advance together and push each other."""

from __future__ import annotations

import math
import re
import weakref
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_real, describe
from ..base.schema import TIME, Entry, Number, Rows, check
from ..base.simulation import Simulation
from ..batch import Batch
from ..errors import InputError, NonFiniteError, SolverError
from ..rigid import RigidBatch, RigidBodies
from ..rigid.colliders import BodyCollider
from .bodies import SPARED, Link, find_supports, give, move, velocities_of
from .surfaces import Surfaces

Array = NDArray[np.float64]

_STEP = 1 / 60  # [s], of worlds without rigid bodies
_OFF = 0.25  # of half the thickness, that surfaces may be put back by after an interval, unless
_HALVINGS = 5  # it was halved so often
_BACK = 20  # interrupts while an interval is undone, after which that is begun again
_SUMS = (
    "kinetic_energy",
    "gravitational_energy",
    "elastic_energy",
    "energy",
    *(f"{name}_{axis}" for name in ("momentum", "angular_momentum") for axis in "xyz"),
)


class _Clock:
    """What stands for a native simulation."""

    time = 0.0

    def __init__(self, members: Mapping[str, Simulation]) -> None:
        self._members = members
        self._made = False

    @property
    def threads(self) -> int:
        return next(iter(self._members.values())).threads or 0

    @threads.setter
    def threads(self, threads: int) -> None:
        if self._made:
            for member in self._members.values():
                member.threads = threads or None
        self._made = True  # members keep theirs until somebody sets that of the world


class World(Simulation):
    """Simulations of several kinds in one world, which push each other.

    Rigid bodies interact with members whose obstacles represent them: make those by
    `RigidBodies.make_colliders` and give them to the other simulation as its `colliders`. The world
    then moves the obstacles with the bodies, and gives to the bodies what the other simulation
    pushes them by. How a body yields is part of the equations that the other simulation solves, so
    that a light body is as stable as a heavy one. In the same way others meet the surfaces of cloth
    and soft bodies, of which `MassSpring.make_colliders` and its like make the obstacles.

    The world is a simulation as its members are: it steps, saves, restores and copies all of them
    at once. Members can be read, and written between steps, but the world alone steps them.

    Parameters
    ----------
    members : mapping of str to Simulation
        The simulations by name, all with equal `time`; at most one `RigidBodies` among them. Names
        are letters, digits and '_'.
    step : float, optional
        Interval between exchanges [s]; unless given the step of the rigid bodies, or without them
        the shortest one of those whose surfaces are obstacles. Within it each simulation takes
        steps of its own.
    threads : int, optional
        For all members; by default each keeps its own.

    Raises
    ------
    InputError
        If members are at different times, or one is given twice or is in another world, or an
        obstacle represents a body of a `RigidBodies` that is no member, or a dynamic one that
        its simulation cannot push, or a surface of no member, or one that its simulation cannot
        meet.

    References
    ----------
    Batty, Bertails and Bridson, "A fast variational framework for accurate solid-fluid coupling",
    2007; Macklin, Mueller, Chentanez and Kim, "Unified particle physics for real-time
    applications", 2014.

    Examples
    --------
    A ball of a third of the water's density floats:

    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> ball = bodies.add(substep.Sphere(0.15), (0.5, 0.5, 0.45), density=300.0)
    >>> water = substep.GridLiquid(
    ...     substep.fill_box((0, 0, 0), (1, 1, 0.4), 0.05), cell=0.1,
    ...     bounds=((0, 0, 0), (1, 1, 1)), colliders=bodies.make_colliders(ball))
    >>> world = substep.World({"bodies": bodies, "water": water})
    >>> world.advance(0.5)
    >>> bool(0.3 < bodies.positions[ball, 2] < 0.6)
    True
    """

    _members: dict[str, Any]
    _links: list[Link]
    _surfaces: Surfaces

    def __init__(
        self,
        members: Mapping[str, Simulation],
        *,
        step: float | None = None,
        threads: int | None = None,
    ) -> None:
        given = _check_members(members)
        self._members = given
        self._links = [link for name in given if (link := _find_link(name, given)) is not None]
        self._exchanged = [np.zeros((len(link.ids), 6)) for link in self._links]  # [N s], [N m s]
        self._surfaces = Surfaces(given)
        self._interval = 0.0  # in which that was exchanged [s]; 0 before the first
        self._step_size = None if step is None else check_real("step", step, positive=True)
        times = {member.time for member in given.values()}
        if len(times) > 1:
            told = ", ".join(f"{name!r} at {m.time:g} s" for name, m in given.items())
            raise InputError(f"members: expected all at one time, got {told}")
        if self._bodies is not None:
            for link in self._links:
                link.rows(self._bodies)
        clock = _Clock(given)
        super().__init__(clock, times.pop(), clock.threads or None)
        if threads is not None:
            self.threads = threads
        self._take_in()
        if self._bodies is not None:
            for link in self._links:
                link.warn_of_small(self._bodies)

    def _take_in(self) -> None:
        for member in self._members.values():
            with member._owner:
                member._owner.begin("members")  # not from within a callback of its own
            self._owner.join(member._owner)
        with self._owner:  # another thread may have taken one
            for name, member in self._members.items():
                _check_free(name, member)
            for member in self._members.values():
                member.__dict__["_world"] = weakref.ref(self)

    def __repr__(self) -> str:
        met = [f"{link.name} meets {len(link.ids)} bodies" for link in self._links]
        met += [f"{link.name} meets {link.source}" for link in self._surfaces.links]
        return f"World({', '.join(self._members)}; {', '.join(met) or 'nothing meets another'})"

    @property
    def members(self) -> Mapping[str, Any]:
        """The simulations by name; read-only."""
        return MappingProxyType(self._members)

    def __getitem__(self, name: str) -> Any:
        """Give the member of that name.

        Parameters
        ----------
        name : str
            Of the member.

        Returns
        -------
        Simulation
            The member.

        Raises
        ------
        KeyError
            If there is none.
        """
        if name not in self._members:
            raise KeyError(f"{name!r}; the world has {', '.join(self._members)}")
        return self._members[name]

    @property
    def _bodies(self) -> RigidBodies | None:
        return next((m for m in self._members.values() if isinstance(m, RigidBodies)), None)

    def _next_step(self) -> float:
        return self._step_size or self._longest()

    def _longest(self) -> float:
        if self._bodies is not None:
            return self._bodies.step_size or _STEP
        return min([_STEP, *(self._members[name].step_size for name in self._surfaces.sources)])

    def _begin(self, method: str) -> None:
        super()._begin(method)
        self._check_times()
        for member in self._members.values():
            member._begin_within()

    def _check_times(self) -> None:
        for name, member in self._members.items():
            if member.time != self.time:
                raise InputError(
                    f"members: {name!r} is at {member.time:g} s, the world at {self.time:g} s; "
                    "let the world alone step them"
                )

    def _take_step(self, dt: float) -> None:
        self._check_times()  # a callback may have restored one
        self._step_to(self.time + dt, dt, _HALVINGS)

    def _step_to(
        self,
        end: float,
        dt: float,
        halvings: int,
        loose: frozenset[int] = frozenset(),
        repeats: bool = False,
    ) -> None:
        """One interval of exchange; where a member fails, all are as they were.

        No support holds bodies that are loose. Repeats: of an interval whose impulses are known.
        """
        bodies = self._bodies if self._links else None
        go_back, counted = self._way_back(), self._surfaces.keep()
        try:
            # A remnant of rounding had impulses of its own.
            scale = min(dt / self._interval, 2.0**_HALVINGS) if self._interval > 0 else 0.0
            self._surfaces.begin(scale, dt, end, self._name_errors)
            if bodies is None:
                for name in self._surfaces.order:
                    self._advance(name, dt, end)
                self._interval = dt if self._surfaces.links else 0.0
            else:
                rows = [link.rows(bodies) for link in self._links]
                last = [scale * impulses for impulses in self._exchanged]
                is_first = self._interval == 0
                tried, supported, held = self._try(bodies, rows, last, dt)
                supported[list(loose)] = False
                touched, released = self._exchange(
                    bodies, rows, last, tried, supported, held, dt, end
                )
                gave_way = (held & (bodies._native.parts_of_strength() >= 1)).any()
                # Again, with impulses that are known now.
                if released or (is_first and touched) or (gave_way and not repeats):
                    found = self._exchanged
                    go_back()
                    self._surfaces.put_back(counted)
                    if not released:
                        self._exchanged, self._interval = found, dt
                    self._step_to(end, dt, halvings, loose | released, repeats or not released)
                    return
            self._native.time = end
            if halvings > 0 and self._surfaces.off() > _OFF:
                go_back()
                self._surfaces.put_back(counted)
                self._step_to(end - dt / 2, dt / 2, halvings - 1)
                self._step_to(end, dt / 2, halvings - 1)
            self._release()
        except BaseException as error:
            try:
                self._undo(go_back, counted, error)
            except KeyboardInterrupt:
                self._undo(go_back, counted, error)
            raise

    def _release(self) -> None:
        """Let all obstacles move as they are told: alone, a member has no bodies."""
        for link in self._links:
            link.release()
        self._surfaces.release()

    def _undo(self, go_back: Callable[[], None], counted: Any, error: BaseException) -> None:
        """Go back to before an interval that failed, also where Ctrl-C comes once more."""
        for tried in range(_BACK):
            try:
                go_back()
                self._surfaces.put_back(counted)
                self._release()
                return
            except NonFiniteError:
                # Rows as users wrote them into views: the first step refused them.
                raise error from None
            except MemoryError:
                raise
            except BaseException:
                if tried == _BACK - 1:
                    raise

    def _try(
        self, bodies: RigidBodies, rows: list[Any], last: list[Array], dt: float
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """How the velocities of the bodies change in a step with the impulses of the last one.

        And which of them have supports in it, and which joints hold their coordinates. The step is
        not taken.
        """
        every, native = np.arange(len(bodies)), bodies._native
        start, forces, torques = velocities_of(bodies, every), native.forces, native.torques
        own = forces.copy(), torques.copy()
        try:
            before = bodies._kept()
            self._move(bodies, rows, last, dt)
            change = velocities_of(bodies, every) - start
            supported = native.supported().astype(bool)
            held = native.parts_of_strength() < SPARED
            bodies._put_state(before)
        finally:
            native.forces[:], native.torques[:] = own
        return change, supported, held

    def _exchange(
        self,
        bodies: RigidBodies,
        rows: list[Any],
        impulses: list[Array],
        tried: Array,
        supported: NDArray[np.bool_],
        held: NDArray[np.bool_],
        dt: float,
        end: float,
    ) -> tuple[bool, set[int]]:
        """The algorithm of `bodies.py`, after its first line.

        Returns whether others touch the bodies, and those that left what held them: if any did, the
        bodies have not moved.
        """
        start = velocities_of(bodies, np.arange(len(bodies)))
        W = np.zeros((len(bodies), 6, 6))
        links = {link.name: k for k, link in enumerate(self._links)}
        pushed = np.unique(np.concatenate(rows))
        W[pushed] = bodies._native.mobilities(pushed, held, dt)
        new = list(impulses)
        more = np.zeros_like(tried)  # than in the trial
        last_ones = np.zeros_like(tried)
        for at, of_link in zip(rows, new, strict=True):
            np.add.at(last_ones, at, of_link)
        reactions = tried - self._alone(bodies, last_ones, W, dt)
        size = np.abs(tried[:, :3]).max(axis=1) + np.linalg.norm(dt * np.asarray(bodies.gravity))
        free = np.abs(reactions[:, :3]).max(axis=1) <= 1e-9 * (size + 1e-9)
        supports = find_supports(W, supported, reactions, last_ones)
        strays, x = np.zeros_like(tried), bodies.centers_of_mass.copy()
        for name in self._surfaces.order:
            if self._members[name] is bodies:
                continue
            k = links.get(name)
            if k is None:
                self._advance(name, dt, end)
                continue
            at, link, last = rows[k], self._links[k], new[k]
            beside = np.einsum("kij,kj->ki", W[at], more[at] - last)
            link.place(bodies, at, start[at], W[at], (tried[at] + beside) / dt)
            self._advance(name, dt, end)
            new[k] = link.impulses()
            np.add.at(more, at, new[k] - last)
            alone = free[at] & new[k].any(axis=1)
            if alone.any():
                np.add.at(strays, at, alone[:, None] * link.strays(x[at], start[at], dt))
        touched, released = not free[pushed].all(), supports.released(more)
        if released:
            return touched, released
        self._move(bodies, rows, new, dt)
        if strays.any():
            move(bodies, strays)
        bodies._count(dt)
        bodies._native.time = end
        self._exchanged, self._interval = new, dt
        return touched, released

    def _alone(self, bodies: RigidBodies, impulses: Array, W: Array, dt: float) -> Array:
        """How velocities change by nothing but gravity, forces and these impulses."""
        given = impulses + dt * np.concatenate([bodies.forces, bodies.torques], axis=1)
        moves = np.isfinite(bodies.masses)
        given[moves, :3] += dt * bodies.masses[moves, None] * np.asarray(bodies.gravity)
        return np.asarray(np.einsum("kij,kj->ki", W, given))

    def _move(self, bodies: RigidBodies, rows: list[Any], impulses: list[Array], dt: float) -> None:
        """Steps of the bodies, equal ones no longer than theirs, with these impulses."""
        steps = max(1, math.ceil(dt / self._longest() * (1 - 1e-9)))
        for _ in range(steps):
            for at, given in zip(rows, impulses, strict=True):
                give(bodies, at, given / steps, dt / steps)
            self._name_errors(bodies, bodies._take_step, dt / steps)

    def _name_of(self, member: Simulation) -> str:
        return next(name for name, m in self._members.items() if m is member)

    def _advance(self, name: str, dt: float, end: float) -> None:
        member = self._members[name]
        self._name_errors(member, self._surfaces.advance, name, dt, end)
        member._native.time = end

    def _name_errors(self, member: Simulation, call: Callable[..., Any], *given: Any) -> Any:
        """Call it; where it fails, the error says whose it is."""
        try:
            return call(*given)
        except SolverError as error:
            error.args = (f"{self._name_of(member)}: {error}", *error.args[1:])
            error.step = None  # of the member's own
            raise

    def step_limit(self) -> tuple[float, str]:
        """Longest interval that is accurate, and why.

        Returns
        -------
        float
            The step of the rigid bodies, or of the surfaces, or less where their limit, or that of
            another member with steps of a fixed size, is shorter [s]. Members that choose their
            steps do not count.
        str
            The member and its reason.
        """
        whose = "rigid bodies" if self._bodies is not None else "surfaces"
        limits = [(self._longest(), f"the step of the {whose}")]
        for name, member in self._members.items():
            if member._fixed_step and hasattr(member, "step_limit"):
                limit, reason = member.step_limit()
                limits.append((limit, f"{name}: {reason}"))
        return min(limits)

    def diagnostics(self) -> dict[str, float]:
        """Those of the members, and their sums.

        Returns
        -------
        dict of str to float
            `NAME.KEY` for each member; energies [J], momenta [N s] and angular momenta about 0
            [N m s] under their own names are sums over the members that have them.
        """
        values: dict[str, float] = {}
        for name, member in self._members.items():
            theirs: dict[str, float] = member.diagnostics()
            values |= {f"{name}.{key}": value for key, value in theirs.items()}
            for key in _SUMS:
                if key in theirs:
                    values[key] = values.get(key, 0.0) + theirs[key]
        return values

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays of all members for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `NAME.FIELD` for each field of each member.
        """
        return {
            f"{name}.{key}": value
            for name, member in self._members.items()
            for key, value in member.fields().items()
        }

    def exchanged(self) -> dict[str, tuple[NDArray[np.int64], Array]]:
        """What bodies were given in the last interval.

        Returns
        -------
        dict of str to (ndarray, ndarray)
            For each simulation that bodies meet: ids of the bodies, shape (m,), and rows (force
            [N], torque about the centre of mass [N m]), means over the interval, shape (m, 6). They
            are 0 for static and kinematic bodies: see `impulse` of their obstacles.
        """
        duration = self._interval or math.inf
        return {
            link.name: (link.ids.copy(), given / duration)
            for link, given in zip(self._links, self._exchanged, strict=True)
        }

    def _own_schema(self) -> list[Entry]:
        sizes = [(link.name, len(link.ids)) for link in self._links]
        return [
            TIME,
            Number("interval", low=0),
            *(Rows(f"exchanged.{name}", np.float64, (n, 6)) for name, n in sizes),
            *(Rows(k, np.float64, rows.shape) for k, rows in self._surfaces.state().items()),
        ]

    def _own_state(self) -> dict[str, Any]:
        given = zip(self._links, self._exchanged, strict=True)
        return {
            "time": self.time,
            "interval": self._interval,
            **{f"exchanged.{link.name}": rows.copy() for link, rows in given},
            **self._surfaces.state(),
        }

    def _state(self) -> dict[str, Any]:
        self._check_times()  # nothing would take it back
        state = self._own_state()
        for name, member in self._members.items():
            state |= {f"{name}.{key}": value for key, value in member._state().items()}
        return state

    def _checked(self, state: dict[str, Any]) -> dict[str, Any]:
        schemas = {name: member._schema()[0] for name, member in self._members.items()}
        names = [f"{name}.{entry.name}" for name, schema in schemas.items() for entry in schema]
        names += [entry.name for entry in self._own_schema()]
        if isinstance(state, Mapping):
            given = {key.split(".")[0]: 0 for key in map(str, state) if "." in key}
            given.pop("exchanged", None)
            if given and given.keys() != self._members.keys():
                raise InputError(
                    f"state: expected that of a world of the members {', '.join(self._members)}, "
                    f"got that of {', '.join(given)}"
                )
            if missing := [name for name in names if name not in state]:
                raise InputError(f"state: {', '.join(sorted(missing))} missing")
        theirs = {}
        for name, member in self._members.items():
            start = f"{name}."
            part = {k[len(start) :]: v for k, v in state.items() if str(k).startswith(start)}
            theirs[name] = _naming(name, member._checked, part)
        own = check(self._own_schema(), state, {})
        for name in self._members:
            if theirs[name]["time"] != own["time"]:
                raise InputError(f"state['{name}.time']: expected that of the world, {own['time']}")
        return {"own": own, "members": theirs}

    def _refuse(self, given: dict[str, Any]) -> None:
        for name, member in self._members.items():
            _naming(name, member._refuse, given["members"][name])

    def _kept(self) -> dict[str, Any]:
        theirs = {name: member._kept() for name, member in self._members.items()}
        return {"own": self._own_state(), "members": theirs}

    def _way_back(self) -> Callable[[], None]:
        if self._surfaces.links:  # intervals are done in halves, each with a way back
            return super()._way_back()
        own = self._native.time, self._interval, self._exchanged
        back = [member._way_back() for member in self._members.values()]

        def go_back() -> None:
            self._native.time, self._interval, self._exchanged = own
            for member_back in back:
                member_back()

        return go_back

    def _put_state(self, state: dict[str, Any]) -> None:
        own = state["own"]
        for name, member in self._members.items():
            member._put_state(state["members"][name])
        self._native.time, self._interval = own["time"], own["interval"]
        self._exchanged = [own[f"exchanged.{link.name}"].copy() for link in self._links]
        self._surfaces.pushed = [own[name].copy() for name in self._surfaces.state()]

    def _parts(self) -> dict[str, Any]:
        """What the world is made of: copies of its members, and whose obstacles are whose."""
        made = super()._parts()
        made["_members"] = {name: member.copy() for name, member in self._members.items()}
        made["_links"] = [(link.name, link.places) for link in self._links]
        made["_surfaces"] = self._surfaces.made()
        return made

    def __setstate__(self, given: tuple[dict[str, Any], int | None, dict[str, Any]]) -> None:
        made, threads, state = given
        members = made["_members"]
        made["_links"] = [Link(name, members[name], places) for name, places in made["_links"]]
        made["_surfaces"] = Surfaces(members, made["_surfaces"])
        super().__setstate__((made, threads, state))
        self._take_in()
        for link in self._links:
            for k, *_ in link.places:
                members[link.name].colliders[k].__dict__["_bodies"] = self._bodies

    def _make(self, state: Mapping[str, Any]) -> Any:
        return _Clock(self._members)


def _check_members(members: Any) -> dict[str, Simulation]:
    if not isinstance(members, Mapping):
        raise TypeError(
            "members: expected simulations by name, such as {'bodies': bodies, 'water': water}, "
            f"got {describe(members)}"
        )
    if not members:
        raise InputError("members: expected at least one")
    given: dict[str, Simulation] = {}
    for name, member in members.items():
        if name == "exchanged":
            raise InputError("members: 'exchanged' is a name in states of the world")
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"members: expected names of letters, digits and '_', got {name!r}")
        if not isinstance(member, Simulation) or isinstance(member, (World, Batch, RigidBatch)):
            raise TypeError(f"members[{name!r}]: expected a simulation, got {describe(member)}")
        if any(member is other for other in given.values()):
            raise InputError(f"members[{name!r}]: is given twice")
        _check_free(name, member)
        given[name] = member
    rigid = [name for name, member in given.items() if isinstance(member, RigidBodies)]
    if len(rigid) > 1:
        raise InputError(f"members: expected one RigidBodies at most, got {', '.join(rigid)}")
    return given


def _naming(name: str, check: Callable[..., Any], part: dict[str, Any]) -> Any:
    """Check the state of a member; errors name its entries as that of the world does."""
    try:
        return check(part)
    except (InputError, TypeError) as error:
        told = re.sub(r"state\['|(?<=, )\['", rf"\g<0>{name}.", str(error))
        raise type(error)(told) from None


def _check_free(name: str, member: Simulation) -> None:
    if member.__dict__.get("_world", lambda: None)() is not None:
        raise InputError(f"members[{name!r}]: is in another world")


def _find_link(name: str, members: Mapping[str, Simulation]) -> Link | None:
    """The obstacles of a member that stand for bodies of another."""
    member = members[name]
    places = []
    for k, collider in enumerate(member.colliders):
        if not isinstance(collider, BodyCollider):
            continue
        bodies = collider.__dict__.get("_bodies")
        if bodies is None or not any(bodies is m for m in members.values()):
            raise InputError(
                f"members: colliders[{k}] of {name!r} represents a body of no member; make it by "
                "make_colliders() of the RigidBodies that is one"
            )
        places.append((k, collider.body, *collider._place()))
    return Link(name, member, places) if places else None
