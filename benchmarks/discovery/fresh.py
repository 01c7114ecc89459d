"""Mechanisms in no catalogue that were written by somebody who does not know the workflow, for a blind test.

The author read the forms, the other kinds and the world of this benchmark, never the program that is tested, and ran
the kinds for nothing but their size in detection limits. Every kind says what separates it from the listed mechanisms.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.hidden import PULL, TORQUE, Form, drawn, enter
from benchmarks.discovery.world import column

FRESH: list[Form] = []
_fresh = partial(enter, FRESH, "")


def _begins(rows):
    """Rows in which a run begins: within a run the slip rises."""
    return np.concatenate([[True], np.diff(rows.slip) < 0.0])


@_fresh("gain of sinkage for each factor e of standing time [-]", 0.3)
def settling_at_rest(contact, s, side):
    """Between readings the wheel stands under load and the soil creeps with the logarithm of time (Buisman 1936).

    The wheel sets off from its pit and is read before it is out: z [1 + s ln(t/30 s)], no rest before a run. Listed
    rates know the speed, not the rest; an unsettled wheel comes from the depth of the row before, for however long.
    """
    rest = np.where(_begins(contact.rows), 30.0, np.diff(contact.rows.time, prepend=0.0))
    deeper = 1.0 + s * np.log(column(np.maximum(rest, 30.0)) / 30.0)
    contact.deepening.append(lambda z: z * deeper)


@_fresh("exponent of the load of the bed before in S [-]", 0.9, side=drawn("load", friction=(0.0, 0.2)))
def traces_of_last_bed(contact, s, side):
    """The tiller does not undo all compaction, so that a new bed is firmer where the bed before bore a heavy wheel.

    S goes with the load before, in part also phi, and one value holds for the three passes of a bed. Listed multipass
    grows within a bed and knows no other bed; uneven beds are random, and places of a lane are alike in all beds.
    """
    rows = contact.rows
    starts = np.flatnonzero(_begins(rows) & (rows.passes == 1.0))
    bed = np.searchsorted(starts, np.arange(len(rows)), side="right") - 1
    heavy = np.where(bed > 0, rows.load[starts[np.maximum(bed - 1, 0)]] / side["load"], 1.0)
    contact.stiffness = contact.stiffness * column(heavy) ** s
    contact.tan_phi = contact.tan_phi * column(heavy) ** (side["friction"] * s)


@_fresh("gain of the radius of the contact at the mean load [-]", 1.0, side=drawn("load", power=(0.7, 1.3)))
def flattening_wheel(contact, s, side):
    """A wheel that is not rigid flattens under its load and meets the soil as part of a larger circle (Bekker 1956).

    The longer contact sinks less and pulls more, most at heavy loads. Listed effects know no wheel that yields; a wrong
    radius is one value for all loads and falsifies slip; an eccentric wheel swings with the way.
    """
    larger = 1.0 + s * (contact.load / side["load"]) ** side["power"]
    contact.radius, contact.shear_radius = contact.radius * larger, contact.shear_radius * larger
    lever = larger[:, 0]  # the axle stays as high above the ground as before
    contact.sensors.append(lambda out: replace(out, torque=out.torque / lever))


@_fresh("load that is lost at a sinkage of 0.1 r over the mean load [-]", 0.5, side=drawn("load"))
def relaxing_spring(contact, s, side):
    """A preloaded spring presses the wheel down, set on the surface, and gives less the deeper the wheel sinks.

    The load on the soil is W - k z: deep rows lose sinkage, pull and torque together, whatever made them deep. A hard
    floor holds the sinkage and keeps the load; listed effects keep the load, and a leak takes it with time.
    """
    rate = s * side["load"] / 0.1
    contact.forces.append(lambda entry: (rate * (1.0 - np.cos(entry)), 0.0 * entry, 0.0 * entry))


@_fresh("load that is added for a unit of torque over radius [-]", 0.8, signs=(1, -1))
def torque_on_arm(contact, s, side):
    """The wheel hangs on a swing arm that takes the torque of its drive too, and so presses it down or lifts it.

    The load on the soil is W + s T/r, which the table does not have. It is there on level ground, unlike listed weight
    transfer, and changes all channels with slip, to less sinkage as well; crosstalk of a cell leaves the soil alone.
    """

    def hook(entry):
        _, tau, weight = contact.stresses(entry)
        pressed = s * (contact.areas(weight)[1] * tau).sum(1, keepdims=True)
        return -pressed, 0.0 * pressed, 0.0 * pressed

    contact.forces.append(hook)


@_fresh("gain of the torque that is read after long work at the mean load [-]", 0.6, (TORQUE,),
        side=drawn("load", "radius", cools=(400.0, 3000.0)))  # fmt: skip
def hot_motor(contact, s, side):
    """Torque from the current of a motor whose magnets weaken as it heats, with the square of the torques before.

    The gain follows hard work by minutes and is lost while a bed is prepared. Listed friction of the drive and a cold
    seal add a torque; a wrong gain is constant, and saturation knows the present torque only.
    """
    pause = np.diff(contact.rows.time, prepend=0.0)  # [s]

    def read(out):
        power, warm = (out.torque / (0.4 * side["load"] * side["radius"])) ** 2, np.zeros(len(pause))
        for k in range(1, len(pause)):
            gained = -np.expm1(-min(pause[k], 90.0) / side["cools"]) * power[k - 1]
            warm[k] = warm[k - 1] * np.exp(-pause[k] / side["cools"]) + gained
        return replace(out, torque=out.torque * (1.0 + s * warm))

    contact.sensors.append(read)


@_fresh("share of the last pull that is zeroed [-]", 0.6, (PULL,))
def zeroed_under_pull(contact, s, side):
    """The load cell is zeroed as soon as a run stops, while wheel and soil still hold a part of its last pull.

    The next run is read short by it: one zero for each run, of either sign, from the load and soil of the run before.
    A wrong zero is constant; an unsettled wheel passes sinkage on from row to row, here a whole run has one error.
    """
    rows = np.arange(len(contact.rows))
    before = np.maximum.accumulate(np.where(_begins(contact.rows), rows, 0)) - 1  # last row of the run before

    def read(out):
        held = np.where(before >= 0, out.drawbar_pull[before], 0.0)
        return replace(out, drawbar_pull=out.drawbar_pull - s * held)

    contact.sensors.append(read)


@_fresh("amplitude of the zero over the mean load [-]", 0.15, (PULL,),
        side=drawn("load", "time", period=(0.25, 1.0), phase=(0.0, 6.28)))  # fmt: skip
def heated_hall(contact, s, side):
    """The zero of the load cell follows the temperature of the hall, which the heating lets rise and fall by the clock.

    Pull alone swings with the time, whatever the row. A wrong zero is constant, a drifting one of the catalogue is of
    the sinkage; carriage drag goes with speed, and firm places of a lane come back in each run.
    """
    swing = np.cos(2.0 * np.pi * contact.rows.time / (side["period"] * side["time"]) + side["phase"])
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull + s * side["load"] * swing))
