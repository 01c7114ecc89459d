"""The slip controller that a guided agent trims (`agents.guided`), as nodes of an ONNX graph."""

from __future__ import annotations

import copy

import numpy as np

from ..controllers import CHANGE, BestSlipIdentified
from ..guided import Guide
from .contact import best_slip
from .graph import Graph, Traced


class GuideGraph:
    """A guide, its laws run on values of the graph; its hidden states are named `sizes`."""

    def __init__(self, graph: Graph, guide: Guide):
        self.graph, self.guide = graph, guide
        self.controller = copy.copy(guide.controller)
        self.sizes = {"guide_integral": 0}
        if isinstance(guide.controller, BestSlipIdentified):
            self.sizes |= {"guide_known": 8, "guide_slip": 0}
        self._kept: dict[str, Traced] = {}
        self._batch = self._target = None

    def observe(self, observation: Traced, memory: dict[str, Traced], fresh: Traced) -> Traced:
        """What the network sees [n, D + 2] float32, for observations [n, D] float32; `fresh` [n] bool: new courses."""
        c, g = self.controller, self.graph
        self._batch = batch = observation.astype(np.float64)
        if "guide_slip" in self.sizes:
            slip = self._best_slip(batch, memory, fresh)
            c.target_slip = lambda batch, state: slip
        integral = np.where(fresh, c._feed_forward(batch), memory["guide_integral"])
        state = {"integral": integral, "fresh": fresh}
        self._target = c.rim_speed(batch, state)
        self._state = state
        slip = self._target * 0.0 + c.target_slip(batch, state)
        own = [(self._target / c.top_speed)[:, None], slip[:, None]]
        return g.concat([batch, *own]).astype(np.float32)

    def act(self, actions: Traced) -> Traced:
        """Commands [n, 1] float32 for the network's actions [n, 1]."""
        speed = self.guide.trimmed(actions.astype(np.float64)[:, 0], self._target)
        return self.controller.command(self._batch, speed, self._state)

    def kept(self) -> dict[str, Traced]:
        """{name: hidden state} after `act`."""
        return {"guide_integral": self._state["integral"]} | self._kept

    def _best_slip(self, batch: Traced, memory: dict[str, Traced], fresh: Traced) -> Traced:
        """`target_slip` of the controller: found again where soil or load have changed, once for all rows."""
        c, g, wheel = self.controller, self.graph, self.controller.scenario.wheel
        soil, load = c.soil_columns(batch), c.load(batch)
        now = g.concat([(load * 0.0 + x)[:, None] for x in (*soil, load)])
        known = np.where(fresh[:, None], 0.0, memory["guide_known"])
        change = np.abs(now - known) - CHANGE * np.abs(known)
        changed = g.node("ReduceMax", change, axes=[1], keepdims=0) > 0.0
        some = g.node("ReduceMax", changed.astype(np.int64), keepdims=0, dtype=np.int64).astype(bool)
        old = memory["guide_slip"]

        def found(child: Graph) -> Traced:
            columns = [x.at(child) if isinstance(x, Traced) else x for x in soil]
            new = best_slip(child, columns, load.at(child), wheel.radius, wheel.width, wheel.stall_torque)
            return np.where(changed, new, old)

        slip = g.branch(some, found, lambda child: child.node("Identity", old))
        self._kept = {"guide_known": np.where(changed[:, None], now, known), "guide_slip": slip}
        return slip
