"""Identify the soil while a rover drives: one JSON object of readings a line, from stdin or by UDP, estimates out.

A ROS 2 node makes the same call for each message. The names are those of `soil_env.online.Readings`, in SI units;
readings that are not measured are left out.

Examples:
    python examples/live_identifier.py                   a rover in the simulator sends its readings by UDP
    python examples/live_identifier.py --udp 5005        waits for datagrams; ends after --quiet seconds without one
    echo '{"wheel_speed": 2.0, "speed": 0.25, "sinkage": 0.02, "torque": 5, "time": 0.1}' |
        python examples/live_identifier.py --stdin
"""

import argparse
import json
import socket
import sys
import threading
import time
from collections.abc import Iterable, Iterator

from soil_env.online import OnlineIdentifier, Readings
from soil_env.parameters import load_scenario

SCENARIO = load_scenario("mixed")


def identify(lines: Iterable[str]) -> tuple[int, OnlineIdentifier]:
    """Print renewed estimates; return the number of readings, and the identifier."""
    identifier, count = OnlineIdentifier.of_scenario(SCENARIO), 0
    for line in lines:
        try:
            estimate = identifier.update(Readings(**json.loads(line)))
        except (TypeError, ValueError) as error:  # no JSON, an unknown name, a time that is not later
            print(f"left out: {error}", file=sys.stderr)
            continue
        count += 1
        if estimate.renewed:
            angle = f"{estimate.friction_angle_deg:.1f} +- {estimate.friction_angle_sd_deg:.1f} deg"
            modulus, coefficient = 1e3 * estimate.shear_modulus, estimate.sinkage_coefficient
            print(f"phi {angle}, K {modulus:.1f} mm, S {coefficient:.2e}, {estimate.status.name}")
    return count, identifier


def datagrams(port: socket.socket, quiet: float) -> Iterator[str]:
    """Datagrams of a bound socket as text, until none has come for `quiet` seconds."""
    port.settimeout(quiet)
    while True:
        try:
            yield port.recv(4096).decode("utf-8", "replace")
        except TimeoutError:
            return


def rover(steps: int, seed: int) -> Iterator[str]:
    """Readings of a drive of SoilWheel-v0 as JSON, of the sensors of most rovers: no pull, no load."""
    import gymnasium

    env = gymnasium.make("soil_env:SoilWheel-v0", scenario=SCENARIO, action="torque", scaled=False).unwrapped
    radius, weight = SCENARIO.wheel.radius, SCENARIO.weight
    top = radius * SCENARIO.wheel.no_load_speed
    env.reset(seed=seed)
    for step in range(1, steps + 1):
        observation, _, terminated, truncated, _ = env.step([0.3 + 0.2 * (step % 40 < 20)])
        o = dict(zip(env.observation_names, observation.tolist(), strict=True))
        yield json.dumps({
            "wheel_speed": o["rim_speed"] * top / radius, "speed": o["speed"] * top, "sinkage": o["sinkage"] * radius,
            "torque": o["torque"] * weight * radius, "pitch": o["pitch"], "time": 0.1 * step,
        })  # fmt: skip
        if terminated or truncated:
            return


def send(lines: Iterable[str], address: tuple[str, int], pause: float = 0.002) -> None:
    """Send each line as a datagram."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for line in lines:
            out.sendto(line.encode(), address)
            time.sleep(pause)


def main() -> None:
    """Parse the command line and run the node."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = p.add_mutually_exclusive_group()
    source.add_argument("--stdin", action="store_true", help="read lines from stdin")
    source.add_argument("--udp", type=int, metavar="PORT", help="listen at this port of this machine")
    p.add_argument("--quiet", type=float, default=5.0, help="seconds without a datagram after which it ends")
    p.add_argument("--steps", type=int, default=300, help="readings of the simulated rover")
    options = p.parse_args()
    if options.udp is not None and not 1 <= options.udp <= 65535:
        p.error(f"--udp {options.udp}: expected a port, from 1 to 65535")
    if options.stdin:
        count, identifier = identify(sys.stdin)
    else:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
            port.bind(("127.0.0.1", options.udp or 0))
            if options.udp is None:
                lines = list(rover(options.steps, seed=0))
                threading.Thread(target=send, args=(lines, port.getsockname()), daemon=True).start()
            count, identifier = identify(datagrams(port, options.quiet if options.udp else 1.0))
    print(f"{count} sets of readings; {identifier.soil()}")


if __name__ == "__main__":
    main()
