"""The classical controllers and the oracle: SB3's `predict`, the layouts they read, the drive of a
wheel.
"""

import math
import re
from functools import partial

import gymnasium
import matplotlib.image
import numpy as np
import pytest

from soil_env.cli import main
from soil_env.envs.rover_env import SoilRoverEnv
from soil_env.parameters import Noise, load_rover, load_scenario, soils
from soil_env.parameters.sensors import calibrated
from soil_env.simulation.task import Cause, layout
from soil_env.simulation.task.scaling import Scaling
from soil_env.terramechanics.steady import steady_state
from soil_env.terramechanics.traversability import SLIPS, best_working_point
from soil_env_agents.controllers import CONTROLLERS, checked_settings, make_controller
from soil_env_agents.controllers.oracle import Oracle
from soil_env_agents.controllers.rover import ROVER_CONTROLLERS, make_rover_controller
from soil_env_agents.drive import _drive
from soil_env_agents.evaluate import driving
from soil_env_agents.evaluate.driving import drive as evaluation_drive, run_courses
from soil_env_agents.evaluate.own import made
from tests.agents.drivers import Half, Torques, observations
from tests.agents.test_cloning import memory
from tests.refusals import refused, refused_command
from tests.simulation.courses import EVEN
from tests.simulation.wheels import started

NAMES = tuple(CONTROLLERS)
BY_RIM_SPEED = tuple(
    name for name in NAMES if name not in ("full_throttle", "constant_torque", "best_route")
)
ACTIONS = ("torque", "wheel_speed", "rim_acceleration")
WITHOUT_NOISE = ("sinkage", "drawbar_pull", "torque", "load", "speed", "wheel_speed", "pitch")
#: `noise` of a scenario whose sensors have no error.
QUIET = vars(calibrated(Noise(**dict.fromkeys(WITHOUT_NOISE, 0.0))))
SEED = 2_000_029
TORQUE = {"control": {"action": "torque"}}
BLIND = [entry.name for entry in layout("blind")]


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("scenario", ["mixed", "two_lines", "field_vehicle"])
def test_a_controller_refuses_an_observation_that_is_not_its_own(scenario, action):
    """Scaled ones, of another variant and of another layout, in one line at the first call."""
    task = load_scenario(scenario, {"control": {"action": action}})
    for name in NAMES:
        controller = make_controller(name, task)
        seen = started(task, controller.variant, [[5, k] for k in range(4)]).worlds.observation
        scaled = Scaling(layout(controller.variant, task.course))(seen)
        controller.predict(seen)
        for wrong, said in (
            (scaled, "values in their units, as scaled=False"),
            (scaled[0], "values in their units"),
            (seen[:, :-1], f"expected {seen.shape[1]} numbers, those of"),
            (np.full_like(seen, np.nan), "slip = nan: expected -1 to 1: values in"),
        ):
            refused(partial(controller.predict, wrong), said)
    other = started(load_scenario("mixed"), "identified", [[5, 0]]).worlds.observation
    if scenario == "two_lines":  # as many numbers as `blind` has here
        refused(lambda: make_controller("soft_start", task).predict(other), "here_class")


@pytest.mark.parametrize("name", BY_RIM_SPEED)
def test_a_state_of_other_courses_is_refused(name):
    """Were it taken for one of courses that begin, every ramp would begin anew."""
    controller = make_controller(name, load_scenario("mixed", TORQUE))
    seen = observations(load_scenario("mixed"), controller.variant, 3)
    state = controller.predict(seen)[1]
    controller.predict(seen, state)
    for wrong in (controller.predict(seen[:2])[1], "x", np.zeros((3, 4)), {}):
        said = refused(partial(controller.predict, seen, wrong), "last predict of 3 observations")
        assert said.startswith("state = ")


def test_a_controller_of_a_rover_refuses_scaled_observations():
    rover = load_rover()
    for name in ROVER_CONTROLLERS:
        controller = make_rover_controller(name, rover)
        env = SoilRoverEnv(rover, observation=controller.variant, info="none")
        refused(partial(controller.predict, env.reset(seed=1)[0]), "scaled=False")


def uniform(soil="lete_sand", grade=0.0, action="torque", noise=QUIET, length=12.0, payload=0.0):
    """`mixed` with one soil everywhere, one grade [deg], no halts; `length` [m], `payload` [kg].

    No soil is drawn again for want of pull.
    """
    course = {
        "length": length,
        "halt_time": 0.0,
        "least_pull": -1.0,
        "grade_deg": [grade] * 2,
        "first_grade_deg": [grade] * 2,
        "payload": [payload] * 2,
    }
    changes = {
        "soils": {soil: 1.0},
        "spread": EVEN,
        "noise": noise,
        "control": {"action": action},
        "course": course,
    }
    return load_scenario("mixed", changes)


def drive(controller, scenario, steps, seed=0):
    """Drive for at most so many actions: ({name: values [actions]}, `Cause`, last state).

    The names are `rim` [m/s], `slip`, `x` [m] and `halted`, a mask.
    """
    sim = started(scenario, controller.variant, [seed])
    rows = []
    state = None
    for step in range(steps):
        action, state = controller.predict(sim.worlds.observation, state, np.array([step == 0]))
        sim.step(0, float(action[0, 0]))
        rows.append(sim.worlds.state[0].copy())
        if sim.worlds.cause[0] != Cause.RUNNING.value:
            break
    seen = np.array(rows)
    out = {name: seen[name] for name in ("slip", "x")}
    out["rim"] = seen["wheel_speed"] * scenario.wheel.radius
    out["halted"] = seen["halt_left"] > 0.0
    return out, Cause(sim.worlds.cause[0]), state


def blind(**values):
    """A blind observation [1, D] of 0 but for `values`."""
    return np.array([[values.get(name, 0.0) for name in BLIND]])


@pytest.mark.parametrize("name", NAMES)
def test_extreme_observations_give_finite_actions_in_range(name):
    controller = make_controller(name, load_scenario("mixed", TORQUE))
    ends = np.array([(e.low, e.high) for e in layout(controller.variant)])
    which = np.random.default_rng(0).integers(0, 2, (200, len(ends)))
    corners = ends[np.arange(len(ends)), which].astype(np.float32)
    state = None
    for _ in range(3):
        actions, state = controller.predict(corners, state, np.zeros(200, dtype=bool))
        assert np.isfinite(actions).all() and np.abs(actions).max() <= 1.0
    single, _ = controller.predict(corners[2])
    assert (actions.shape, single.shape) == ((200, 1), (1,))
    assert actions.dtype == single.dtype == np.float32


@pytest.mark.parametrize("name", BY_RIM_SPEED)
def test_episode_start_resets_only_its_row(name):
    """After the restart of row 1 that row acts as a controller that has seen nothing; the others go
    on.
    """
    controller = make_controller(name, load_scenario("mixed", TORQUE))
    early, late = (
        observations(load_scenario("mixed"), controller.variant, 3, seed) for seed in (0, 50)
    )
    state = None
    for _ in range(6):
        _, state = controller.predict(early, state, np.full(3, state is None))
    kept, _ = controller.predict(late, state, [False, False, False])
    reset, _ = controller.predict(late, state, [False, True, False])
    fresh, _ = controller.predict(late)
    np.testing.assert_array_equal(reset[[0, 2]], kept[[0, 2]])
    assert reset[1, 0] == fresh[1, 0] != kept[1, 0]


def test_best_slip_identified_does_not_see_the_true_soil():
    """Its belief fills what the identifier does not estimate."""
    scenario = load_scenario("mixed", {"belief": {"sinkage_exponent": 0.9, "dig_recovery": 0.4}})
    controller = make_controller("best_slip_identified", scenario)
    seen = observations(scenario, "identified").astype(float)
    # Columns are those of `SoilState`; the observation has the cohesion in kPa.
    soil = controller.soils(seen)
    assert (soil[:, 4] == 0.9).all() and (soil[:, 6] == 0.4).all()
    np.testing.assert_allclose(soil[:, 1], 1000.0 * seen[:, controller.column["cohesion"]])
    np.testing.assert_allclose(soil[:, 5], seen[:, controller.column["dig_gain"]])


@pytest.mark.parametrize("slip", [0.15, 0.3])
def test_fixed_slip_holds_its_slip_where_the_slope_asks_for_less(slip):
    """On a slope on which a wheel at a constant speed has 0.05 less slip. The wheel gains speed at
    the slip to hold, until it is as fast as the motor lets it be."""
    white = vars(calibrated(Noise()))  # without zeros and gains
    easy = uniform(noise=white)
    wheel = easy.wheel
    soil = soils()["lete_sand"].state(wheel.width)
    steady = steady_state(slip - 0.05, easy.weight, soil, wheel.radius, wheel.width)
    grade = math.degrees(math.atan(steady.drawbar_pull / easy.weight))
    scenario = uniform(grade=grade, length=20.0, noise=white)
    controller = make_controller("fixed_slip", scenario, slip=slip)
    out, cause, _ = drive(controller, scenario, scenario.steps)
    between = (np.arange(len(out["rim"])) > 8) & (out["rim"] < 0.6)
    assert cause == Cause.FINISHED and between.sum() >= 5
    assert np.abs(out["slip"][between] - slip).mean() < 0.02
    assert np.abs(out["slip"][-50:] - slip + 0.05).max() < 0.02  # at the top the slope decides


@pytest.mark.parametrize("action", ACTIONS)
def test_soft_start_rises_at_its_acceleration_anew_after_every_halt(action):
    scenario = load_scenario("mixed", {"control": {"action": action}, "noise": QUIET})
    out, _, _ = drive(
        make_controller("soft_start", scenario, acceleration=0.1, speed=0.3), scenario, 300, seed=3
    )
    off = []
    left = 0
    starts = 0
    # `rest`: the wheel was at a halt after the action before.
    for rim, halted, rest in zip(out["rim"], out["halted"], [False, *out["halted"]], strict=False):
        starts += rest and left > 0
        left = 0 if rest else left + 1  # actions since rest
        if not (halted or rest):
            off.append(abs(rim - min(0.1 * scenario.control.duration * left, 0.3)))
    assert starts >= 3  # the loop on the torque has to build up what turns the wheel first
    assert max(off) < {"torque": 0.1, "wheel_speed": 0.04, "rim_acceleration": 0.08}[action]
    assert np.median(off) < 0.04


@pytest.mark.parametrize("state", [{"integral": np.zeros(1)}, {"integral": 3, "ramp": 0}, 5])
def test_the_state_of_another_controller_is_refused(state):
    controller = make_controller("soft_start", load_scenario("mixed"))
    refused(lambda: controller.state_for(blind(), state, np.array([False])), "state = ")


def test_drives_of_one_name_are_refused(capsys):
    asked = ["drive", "--scenario=mixed", f"--controller=a={DRIVERS}:Half,a={DRIVERS}:Counting"]
    said = refused_command(capsys, "soil-env drive", main, *asked)
    assert "expected one of each name" in said.err


def test_a_deep_wheel_creeps():
    """From half of `creep_sinkage` on its top speed falls, and it never exceeds the setting."""
    scenario = load_scenario("mixed")
    for speed, tops in ((0.5, (0.5, 0.5, 0.3, 0.1, 0.1)), (0.05, (0.05,) * 5)):
        top = make_controller("soft_start", scenario).top_speed
        controller = make_controller(
            "soft_start", scenario, acceleration=100.0, speed=speed * top, creep_sinkage=0.4
        )
        for sinkage, expected in zip((0.0, 0.2, 0.3, 0.4, 0.7), tops, strict=True):
            seen = blind(sinkage=sinkage)
            state = controller.state_for(seen, None, np.array([True]))
            assert controller.rim_speed(seen, state) == pytest.approx(expected * top)


def test_slip_limiter_waits_where_a_soft_start_digs():
    """On loose sand with a steep ramp: the slip stays at its limit, where it does not with the ramp
    alone.
    """
    scenario = uniform("dry_sand_loose")
    common = {"acceleration": 0.5, "speed": 0.6}
    free, _, _ = drive(make_controller("soft_start", scenario, **common), scenario, 60)
    controller = make_controller("slip_limiter", scenario, slip=0.35, start=0.04, **common)
    out, _, _ = drive(controller, scenario, 200)
    under_way = (out["rim"] > 0.1) & (np.arange(len(out["rim"])) > 10)
    assert under_way.sum() > 100 and out["x"][-1] > 4.0
    assert np.percentile(out["slip"][under_way], 95) < 0.38
    assert np.percentile(free["slip"][3:], 95) > 0.42


@pytest.mark.parametrize("best", [0.15, 0.5])
def test_extremum_seeking_finds_the_slip_of_the_highest_pull(best):
    """The wheel has the slip that was asked for, and a pull that is highest at `best`; sensors with
    their noise.
    """
    scenario = load_scenario("mixed", TORQUE)
    controller = make_controller("extremum_seeking", scenario, gain=0.5, swing=0.06)
    rng = np.random.default_rng(0)
    state = None
    slip = 0.3
    for step in range(600):
        found = slip + 0.01 * rng.standard_normal()
        pull = 0.3 - 1.5 * (slip - best) ** 2 + 0.01 * rng.standard_normal()
        batch = blind(slip=found, drawbar_pull=pull, rim_speed=0.2 / controller.top_speed)
        state = controller.state_for(batch, state, np.array([step == 0]))
        slip = float(controller.target_slip(batch, state)[0])
    assert state["best"][0] == pytest.approx(best, abs=0.06)


@pytest.mark.parametrize("repeat", [5, 6, 12, 40])
def test_extremum_seeking_swings_however_long_an_action_lasts(repeat):
    """Its swing is sampled more than twice, and the newest reading is a part of the means."""
    scenario = load_scenario("mixed", {"control": {"repeat": repeat}})
    controller = make_controller("extremum_seeking", scenario, swing=0.06)
    state = None
    slips = []
    for step in range(12):
        batch = blind(slip=0.2, drawbar_pull=0.1, rim_speed=0.2 / controller.top_speed)
        state = controller.state_for(batch, state, np.array([step == 0]))
        slips.append(float(controller.target_slip(batch, state)[0] - state["best"][0]))
    assert np.ptp(slips) > 0.1 and 0.0 < state["slip_mean"][0] <= 0.2 and state["power"][0] >= 0.0


def test_the_line_that_a_controller_chooses_is_the_one_that_it_drives():
    """With the true soil hardly a dead end is taken: only where the grade is seen too flat."""
    scenario = load_scenario("two_lines")
    controller = make_controller("best_slip_true", scenario)
    forks = 0
    right = 0
    *_, (sim, _) = evaluation_drive(controller, scenario, 5, range(40))
    worlds = sim.worlds
    courses = worlds.courses
    routes = courses["routes"]
    # Positive for a route that can be climbed; [courses, patches, routes].
    margins = routes["capacity"] - np.tan(courses["forks"]["grade"])[..., None]
    for k in range(40):
        for p in range(courses["drawn"][k]):
            passed = worlds.state["best_x"][k] > courses["patches"]["start"][k, p]
            if passed and margins[k, p].min() < 0.0 < margins[k, p].max():
                forks += 1
                right += margins[k, p, courses["forks"]["taken"][k, p]] > 0.0
    assert forks > 20 and right > 0.9 * forks


@pytest.mark.parametrize("name", [n for n in NAMES if CONTROLLERS[n].bounds])
def test_settings_are_kept_and_wrong_ones_refused(name):
    scenario = load_scenario("mixed", TORQUE)
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    for key, setting in CONTROLLERS[name].bounds.items():
        high = top if setting.rim_speed else setting.high
        assert 0.0 < make_controller(name, scenario).settings[key] <= high
        assert make_controller(name, scenario, **{key: 0.5 * high}).settings[key] == 0.5 * high
        for wrong in (-0.1, 1.001 * high, float("nan"), "much"):
            said = refused(partial(checked_settings, name, scenario, {key: wrong}, "here"))
            assert said.startswith(f"here.{key} = ") and not said.endswith("-")  # no unit
    refused(partial(make_controller, name, scenario, speeed=0.2), "unknown key")


def test_a_top_speed_that_is_printed_can_be_given():
    """Four digits, as `soil-env tune` writes them, are 4e-16 above the top speed here."""
    scenario = load_scenario("firm_and_loose")
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    assert top < 0.9906
    assert checked_settings("fixed_slip", scenario, {"speed": 0.9906}, "") == {"speed": top}


@pytest.mark.parametrize(
    "name",
    [
        "dry_sand",
        "dry_sand_loose",
        "lunar_simulant_nominal",
        "lunar_simulant_hit_lss1",
        "lete_sand",
    ],
)
@pytest.mark.parametrize("payload", [0.0, 4.0])
def test_best_slip_true_picks_the_slip_of_the_best_working_point(name, payload):
    scenario = uniform(name, grade=-2.0, payload=payload)
    wheel = scenario.wheel
    soil = soils()[name].state(wheel.width)
    _, _, state = drive(make_controller("best_slip_true", scenario), scenario, 30)
    load = (wheel.body_mass + payload) * scenario.gravity
    best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque).slip
    assert state["slip"][0] == best and best in SLIPS


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("name", NAMES)
def test_every_controller_crosses_easy_ground(name, action):
    scenario = uniform("lete_sand", grade=2.0, action=action, noise={}, length=4.0)
    runs = run_courses(make_controller(name, scenario), scenario, 5, 8)
    assert (runs.cause == Cause.FINISHED.value).all()


def test_the_integral_neither_winds_up_in_a_halt_nor_on_a_wheel_that_does_not_turn():
    controller = make_controller("constant_speed", load_scenario("mixed", TORQUE))

    def after(steps, state, **seen):
        """(action, state) after so many calls with one blind observation, `seen`."""
        for _ in range(steps):
            action, state = controller.predict(blind(**seen), state, np.array([state is None]))
        return action[0, 0], state

    first, state = after(1, None)
    _, state = after(50, state, halted=1.0)
    assert after(1, state)[0] == pytest.approx(first, abs=1e-6)
    full, state = after(3000, None)
    assert full == 1.0
    assert after(20, state, rim_speed=1.0)[0] < 0.0  # 2 s later it has let go


def test_planning_changes_nothing_in_the_world_and_foresees_no_noise():
    scenario = load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 12.0}})
    sim = started(scenario, "blind", [[SEED, k] for k in range(3)])
    oracle = Oracle(scenario, horizon=2.0)
    refused(lambda: oracle.predict(sim.worlds.observation), "before attach")
    oracle.attach(sim, 1, None)
    refused(lambda: oracle.predict(sim.worlds.observation[:2]), "2 observations", "expected 3")
    before = [memory(sim.worlds, k) for k in range(3)]
    action, _ = oracle.predict(sim.worlds.observation)
    assert action.shape == (3, 1) and np.isfinite(action).all()
    assert [memory(sim.worlds, k) for k in range(3)] == before
    clones = oracle.clones.worlds
    assert (clones.state["x"] != 0.0).any()  # they have driven
    assert not np.isin(clones.state["stream"], sim.worlds.state["stream"]).any()


@pytest.mark.slow
@pytest.mark.parametrize("action", ["torque", "rim_acceleration"])
def test_the_oracle_finishes_courses_that_full_throttle_does_not(action, monkeypatch):
    scenario = load_scenario("two_lines", {"control": {"action": action}})
    blind = run_courses(make_controller("full_throttle", scenario), scenario, SEED, 40)
    failed = np.flatnonzero(blind.metric("finished") < 0.5)[:6]
    assert failed.size == 6
    # The oracle drives the lost courses only.
    rng = driving.course_rng
    monkeypatch.setattr(driving, "course_rng", lambda seed, k: rng(seed, int(failed[k])))
    runs = run_courses(Oracle(scenario), scenario, SEED, 6)
    assert runs.metric("finished").sum() >= 4


def test_drives_are_shown_side_by_side(tmp_path, capsys):
    """Wheels, or rovers, in one picture. An action lasts as long as in the scenario, so that the
    course ends as in a comparison.
    """
    out = tmp_path / "both.png"
    written = ["--frame=15", f"--out={out}"]
    drivers = "--controller=full_throttle,gentle=soft_start"
    assert main(["drive", "--scenario=mixed", drivers, *written]) == 0
    said = capsys.readouterr().out
    assert "full_throttle: RUNNING at" in said and "gentle: RUNNING at" in said
    left, right = np.split(matplotlib.image.imread(out), 2, axis=1)
    assert left.shape == right.shape and np.abs(left - right).mean() > 0.003

    rover = ["--rover=mars_rover", "--controller=equal_speed,torque_by_load"]
    assert main(["drive", *rover, *written]) == 0
    assert re.search(
        r"equal_speed: RUNNING at 0\.\d+ m.*\ntorque_by_load: RUNNING", capsys.readouterr().out
    )
    assert np.std(matplotlib.image.imread(out)[..., :3]) > 0.02  # something is drawn

    held = load_scenario("mixed").control.action_periods
    asked = []

    class Asked(Half):
        """Lists for each call whether a course begins."""

        def predict(self, obs, state=None, episode_start=None, deterministic=True):
            asked.append(bool(episode_start[0]))
            return super().predict(obs)

    env = gymnasium.make(
        "soil_env:SoilWheel-v0", scenario="mixed", observation="blind", repeat=1, scaled=False
    )
    _drive(env, "mine", Asked(), held, 3, 3 * held, 0)  # three actions on the course of seed 3
    assert asked == [True, False, False]


def test_an_action_of_a_class_lasts_as_long_as_it_says(capsys):
    Torques.asked = 0
    controller = f"--controller=t={DRIVERS}:Torques"
    assert main(["drive", "--scenario=mixed", controller, "--seed=3"]) == 0
    (periods,) = map(int, re.findall(r"after (\d+) control", capsys.readouterr().out))
    assert Torques.asked == math.ceil(periods / 3)  # `repeat` of its `drives`


def test_a_class_is_made_for_the_actions_that_it_says():
    """Its loop has the gains of a torque, in the time of its own actions."""
    scenario = load_scenario("mixed")
    own = made(f"{DRIVERS}:Torques", scenario, {}, "")
    assert own.action == "torque" and own.period == pytest.approx(3 * scenario.control.period)


def test_a_video_has_a_frame_for_each_period_asked_for(tmp_path, capsys):
    """A file .mp4 of one drive, and of two side by side until the longer one ends."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    periods = []
    for drivers in ("full_throttle", "full_throttle,gentle=soft_start"):
        out = tmp_path / f"{len(periods)}.mp4"
        options = ["--controller", drivers, "--every", "16", "--out", str(out)]
        assert main(["drive", "--scenario", "mixed", *options]) == 0
        said = capsys.readouterr()
        periods.append(max(map(int, re.findall(r"after (\d+) control", said.out))))
        assert not said.err and periods[-1] > 160
        assert ffmpeg.count_frames_and_secs(out)[0] == math.ceil(periods[-1] / 16)


DRIVERS = "tests.agents.drivers"


@pytest.mark.parametrize(
    "options, said",
    [
        ("--frame=15", "--frame 15: expected --out"),
        ("--every=5", "--every"),
        ("--controller=", "--controller"),
        ("--policy=", "--policy"),
        ("--policy=default --controller=gentle", "--policy default: expected none beside --contr"),
        ("--rover=mars_rover --scenario=mixed", "--scenario mixed: expected none beside --rover"),
        (
            "--rover=mars_rover --controller=default",
            "--controller: default_policy: scenario 'mars_rover': a rover",
        ),
        (
            "--controller=o=soil_env_agents.controllers.oracle:Oracle",
            "--controller: o: plans in the simulation that it is attached to: expected one that",
        ),
        (
            f"--controller={DRIVERS}:LateNaN",
            f"{DRIVERS}:LateNaN: predict gave .nan. in control period 15: expected "
            "finite numbers\n$",
        ),
        (
            f"--controller={DRIVERS}:Old",
            f"--controller: {DRIVERS}:Old: predict failed .Type.*'state'.: expected "
            r"predict\(obs, state, episode_start, deterministic\)\n$",
        ),
    ],
)
def test_a_drive_that_cannot_be_as_asked_is_refused_in_one_line(capsys, options, said):
    error = refused_command(capsys, "soil-env", main, "drive", *options.split()).err
    assert re.match(f"soil-env drive: error: {said}", error), error
