"""A relay made into a plan: leg after leg, arms let go of the box where it stands in between."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from climbplan.limms.arms.branches import noted, solved_branches
from climbplan.limms.arms.held_branches import HeldTask
from climbplan.limms.assembly import initial, latch_arm, latch_box, reach_box
from climbplan.limms.attempts import Attempts
from climbplan.limms.bounds import Connection
from climbplan.limms.corridor import centre_blocks, ways
from climbplan.limms.densify import add_traces
from climbplan.limms.modules.climbing_down import climb_down
from climbplan.limms.modules.limbs import arm, root_on_anchor
from climbplan.limms.modules.straight_ways import leave
from climbplan.limms.modules.stretch_clearance import require_clear_of_all
from climbplan.limms.placement import centre_of, yaw_of
from climbplan.limms.relays import Leg, Relay
from climbplan.limms.scene import Pose, Scene
from climbplan.limms.statement import Limb, Trace
from climbplan.limms.timeline import NOWHERE, STABLE, PlanSoFar

_DOWN = 2.0  # [m] that coming down from a wall counts as, beside driving
_OWNERS = 2  # choices of modules for a leg


class Relaying:
    """Relays of one scene; legs that several of them begin with are planned once."""

    def __init__(
        self,
        scene: Scene,
        attempts: Attempts,
        rng: np.random.Generator,
        start: PlanSoFar | None = None,
        rests: bool = False,
    ) -> None:
        """start: where everything is [as the scene has it]; rests: the box is put down at last."""
        self.start = initial(scene) if start is None else start
        self.attempts, self.rng, self.rests = attempts, rng, rests
        self.known: dict[tuple[tuple[Leg, ...], bool], PlanSoFar | None] = {}

    def plan(self, relay: Relay) -> PlanSoFar | None:
        """Everything until the box is at its goal, or None."""
        world: PlanSoFar | None = self.start
        for number in range(1, len(relay.legs) + 1):
            legs, is_last = relay.legs[:number], number == len(relay.legs)
            if (legs, is_last) not in self.known:
                assert world is not None
                self.known[legs, is_last] = self._leg(world, legs[-1], is_last)
            world = self.known[legs, is_last]
            if world is None:
                return None
        return world

    def _leg(self, world: PlanSoFar, leg: Leg, is_last: bool) -> PlanSoFar | None:
        scene = world.scene
        begin, end = np.array(leg.begin), np.array(leg.end)
        name = Relay((leg,)).named(scene)
        way = ways(centre_blocks(scene), begin, end)
        if way is None:
            self.attempts.notes.append(f"{name}: there is no way for the box")
            return None
        speed = scene.arrival_speed if is_last else 0.0
        task = HeldTask(begin, end, way, leg.is_thrown, speed)
        for owners in _owners(world, leg.connections):
            limbs = [
                _limb(world, module, connection)
                for module, connection in zip(owners, leg.connections, strict=True)
            ]
            found = solved_branches(scene, limbs, task, name, self.attempts)
            for chosen, outcome in found:
                with noted(self.attempts, name):
                    moved = self._carried(world, chosen, leg, outcome.traces)
                    return put_down(moved, chosen, leg) if self.rests or not is_last else moved
        return None

    def _carried(
        self, world: PlanSoFar, limbs: Sequence[Limb], leg: Leg, traces: Sequence[Trace]
    ) -> PlanSoFar:
        """Arms come to their anchors and to the box, and bring it on.

        Raises:
            Blocked: a way is not free, or the carried motion touches something.
        """
        scene, world = world.scene, world.copy()
        for limb, connection in zip(limbs, leg.connections, strict=True):
            name = scene.module_names[limb.module]
            anchor = scene.wall_offset + connection.root
            if world.tip_anchor[limb.module] not in (NOWHERE, anchor):
                world = climb_down(world, limb.module, self.rng)
            world, _ = latch_arm(world, limb.module, connection.root, name, self.rng)
        for i, limb in enumerate(limbs):
            name = f"{scene.module_names[limb.module]}: to the box"
            path = np.concatenate([trace.angles[:, i] for trace in traces])
            reach_box(world, limb, traces[0].position[0], path, name, self.rng)
        latch_box(world, limbs)
        before = len(world.stretches)
        add_traces(world, limbs, traces)
        for stretch in world.stretches[before:]:
            require_clear_of_all(scene, stretch)
        return world


def put_down(world: PlanSoFar, limbs: Sequence[Limb], leg: Leg) -> PlanSoFar:
    """The box stands where the leg ends; its arms let go of it and draw back.

    Raises:
        Blocked: an arm cannot draw back.
    """
    end = np.array(leg.end)
    world.box, world.yaw = centre_of(end), float(yaw_of(end))
    world.box_mode = STABLE
    for limb in limbs:
        anchors = world.base_anchor if limb.box_end == 0 else world.tip_anchor
        anchors[limb.module] = NOWHERE
    for limb in limbs:
        name = f"{world.scene.module_names[limb.module]}: let go"
        root = Pose(limb.fixed_position, limb.other_rotation)
        leave(world, limb.module, root, 1 - limb.box_end, name)
    return world


def _limb(world: PlanSoFar, module: int, connection: Connection) -> Limb:
    scene = world.scene
    latched = world.base_anchor[module] == scene.wall_offset + connection.root
    box_end = 1 if latched else 0
    root = root_on_anchor(scene, connection.root, 1 - box_end)
    return arm(module, connection.side, root, box_end)


def _owners(world: PlanSoFar, connections: Sequence[Connection]) -> Iterator[tuple[int, ...]]:
    """Which modules, those with the least way to their anchors first."""
    scene = world.scene
    ranked = []
    for modules in permutations(range(scene.count), len(connections)):
        cost = 0.0
        for module, connection in zip(modules, connections, strict=True):
            anchor = scene.wall_offset + connection.root
            ends = {int(world.base_anchor[module]), int(world.tip_anchor[module])}
            taken = set(world.base_anchor) | set(world.tip_anchor)
            if anchor in ends:
                continue
            away = world.base_position[module] - scene.wall_position[connection.root]
            cost += float(np.linalg.norm(away)) + _DOWN * (ends != {NOWHERE})
            if anchor in taken:
                cost = np.inf
        if np.isfinite(cost):
            ranked.append((cost, modules))
    for _, modules in sorted(ranked)[:_OWNERS]:
        yield modules
