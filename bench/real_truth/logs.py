"""Which measured logs, where they are, how their columns are read, and what is known of the truth.

Splits: "dev" is for development. "scored" was split off before anyone looked, and has been read since: it
counts as development too. "kept" is every third rig of those found later, in the order found; of these only
columns, units and counts were checked, and none moves. Commits are those at which the paths were seen.

Left out as no heater's power or duty is in them: BaltazarUach/Solar-Greenhouse-Dryer @8f2cb19 (sun alone) and
pkrysztopa/HVAC-equipment-fault-detection @94166e3 (air handling units).
"""

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.real_truth.readers import (
    HOUSE_W,
    Reader,
    air_duct,
    dryer,
    excited_kit,
    fan_calibration,
    greenhouse,
    hall,
    heat_shield,
    klipper,
    lines,
    oven,
    pad,
    pizza_oven,
    plain,
    pwm_chamber,
    roaster,
    run_file,
    table,
    thermal_plant,
    triacs,
    twin_house,
)
from edge.core.errors import DataError

SHARED = "shared"  # logs that lie beside the checkout, see README.md
HEATER_LIKE = ("heater_lag", "sensor_lag", "heater_deadtime", "imperfect_mixing")
BODY_LIKE = ("soil_mass", "wall_mass")


@dataclass(frozen=True, slots=True)
class RealLog:
    """source : repository, or SHARED; commit : of it; paths : within it

    read : text of a file to columns of one recording
    volume_m3, heater_w : what its owner could know; step_s : of the twin
    main : any of these names the effect that the log shows most, none if that is not known
    true : others that are there too
    whole : recordings train or test as wholes, the last third tests; else each is divided in time
    """

    name: str
    split: str
    source: str
    commit: str
    paths: tuple[str, ...]
    read: Reader
    volume_m3: float
    heater_w: float
    step_s: float
    main: tuple[str, ...]
    true: tuple[str, ...] = ()
    fan: str = "none"
    whole: bool = False
    note: str = ""
    highest_c: float | None = None


def texts(log: RealLog, data: Path, repositories: Path) -> list[str]:
    """Its files. Errors: DataError that says where to get them"""
    if log.source == SHARED:
        found = [path for pattern in log.paths for path in sorted(data.glob(pattern))]
        if not found:
            raise DataError(f"{data}: holds no {', '.join(log.paths)}: --data says where the logs lie")
        return [path.read_text(encoding="utf-8", errors="surrogateescape") for path in found]
    return [_show(log, path, repositories) for path in log.paths]


def _show(log: RealLog, path: str, repositories: Path) -> str:
    """Return a file at the log's commit, from a clone called `name` or
    `owner+name/repo`, or a bare one of the latter name.
    """
    owner, _, name = log.source.partition("/")
    mirror = repositories / f"{owner}+{name}" / "repo"
    for place in (mirror / ".git", mirror, repositories / name / ".git"):
        if place.exists():
            command = ["git", f"--git-dir={place}", "show", f"{log.commit}:{path}"]
            found = subprocess.run(command, capture_output=True, check=False)
            if found.returncode:
                raise DataError(f"{place}: {log.commit}:{path}: {found.stderr.decode().strip()}")
            return found.stdout.decode("utf-8", "surrogateescape")
    raise DataError(f"{repositories}: no clone of https://github.com/{log.source}: git clone it there")


BYU = plain("time_s heater_duty humidity temp_air_c outside temp_ambient_c", heads=1, full=100.0)


def _kit(name: str, path: str) -> RealLog:
    return RealLog(
        f"lab kit, {name}", "dev", SHARED, "", (path,), run_file, 1e-4, 3.6, 3.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), note="transistor, sink and thermistor; no air in a box",
    )  # fmt: skip


LOGS: Sequence[RealLog] = (
    RealLog(
        "plywood box, each divided", "dev", SHARED, "", ("heated_box/*.csv",), run_file, 0.03, 42.0, 5.0,
        HEATER_LIKE, BODY_LIKE, note="the heating plate's own temperature was measured: it lags by a minute",
    ),
    RealLog(
        "plywood box, by date", "dev", SHARED, "", ("heated_box/*.csv",), run_file, 0.03, 42.0, 5.0,
        HEATER_LIKE, BODY_LIKE, whole=True,
    ),
    _kit("energy balance", "tclab/energy_balance.csv"),
    _kit("second order", "tclab/second_order.csv"),
    _kit("hybrid", "tclab/hybrid.csv"),
    RealLog(
        "lab kit, another", "dev", "jckantor/CBE30338", "9341811",
        ("notebooks/data/0B.99-Step_Test_Data.csv",),
        table("Time", "T1", "Q1", full=100.0), 1e-4, 3.6, 3.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"),
    ),
    RealLog(
        "25 degC chamber, run 3", "dev", "cellularmitosis/logs", "31b3970",
        ("20180124-25c-chamber/1516867509-run3/out.csv",), pwm_chamber(3.28, 16), 0.02, 10.0, 5.0,
        HEATER_LIKE, BODY_LIKE, note="bang-bang, the room not measured",
    ),
    RealLog(
        "25 degC chamber, run 5", "dev", "cellularmitosis/logs", "31b3970",
        ("20180124-25c-chamber/1516946844-run5/out.csv",), pwm_chamber(3.28, 16), 0.02, 10.0, 5.0,
        HEATER_LIKE, BODY_LIKE,
    ),
    RealLog(
        "Twin House N2, living room", "dev", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataN2Exp1.txt",), twin_house(5, 19, 35), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "lab kit, excited", "scored", "rawlings-group/mlid_2024", "9f1c939", ("data/tclab_prbs.pickle",),
        excited_kit, 1e-4, 3.6, 3.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
        note="a second heater beside it moves too, and nobody says so",
    ),
    RealLog(
        "lab kit, closed loop", "scored", "rawlings-group/mlid_2024", "9f1c939",
        ("data/tclab_cl_dist.pickle",),
        excited_kit, 1e-4, 3.6, 3.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
        note="power and sensor were disturbed on purpose",
    ),
    RealLog(
        "lamp over a plate", "scored", "Subve/System-identification", "e96d6c5", ("heating_system.dat",),
        plain("time_s heater_duty temp_air_c", full=10.0), 1e-3, 300.0, 2.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), highest_c=400.0,
    ),
    RealLog(
        "thermal plant", "scored", "RonakornST/EE436_Lab_Control", "5c98e6d",
        ("P1/data_thermal_labp1_setpoint.txt",), thermal_plant, 1e-3, 20.0, 2.0, HEATER_LIKE, BODY_LIKE,
        highest_c=100.0,
    ),
    RealLog(
        "Peltier oven", "scored", "cellularmitosis/logs", "31b3970",
        tuple(
            f"20180114-pid-oven-tuning/run{name}-250ms.csv"
            for name in (
                "10-p5.0-i0.0-d0.0", "11-p5.0-i0.0-d1.0", "12-p5.0-i0.0-d2.0", "13-p8.0-i0.0-d1.0",
            )
        ),
        oven, 1e-3, 30.0, 1.0, HEATER_LIKE, BODY_LIKE, whole=True,
    ),
    RealLog(
        "Twin House O5, living room", "scored", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataO5Exp1.txt",), twin_house(5, 19, 35), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "Twin House, second experiment", "scored", "open-ideas/IDEAS", "272d82a",
        ("IDEAS/Resources/measurements/validationdataExp2.txt",), twin_house(6, 27, 53), 83.0, HOUSE_W,
        600.0, BODY_LIKE, ("constant_heat", "ambient_offset", "ground_loss"), note="sun and other rooms too",
    ),
    RealLog(
        "building with several zones", "scored", "czagoni/darkgreybox", "280a7cd",
        ("docs/tutorials/data/demo_data.csv",), table("", "Ti", "Ph", full=160.0, temp_ambient_c="Ta"),
        5000.0, 160_000.0, 3600.0, (*BODY_LIKE, *HEATER_LIKE),
    ),
    RealLog(
        "house in winter", "scored", "locie/pySIP", "da70d25", ("data/armadillo/armadillo_data_H2.csv",),
        table("Time", "T_int", "P_hea", full=2500.0, temp_ambient_c="T_ext", solar_w_m2="I_sol"),
        125.0, 2500.0, 1800.0, BODY_LIKE, ("solar_gain", "constant_heat"),
    ),
    RealLog(
        "heater at a controller", "dev", "orri93/analysis", "fbe6f79",
        tuple(f"var/tc/standard/{name}.csv" for name in ("191122", "191123", "200410a")),
        table("time", "temperature", "control", full=255.0, every=8), 0.01, 500.0, 2.0, (), whole=True,
        note="steps; what is heated is described nowhere; power a guess", highest_c=250.0,
    ),
    RealLog(
        "brew kettle", "dev", "Andy1978/Brautomat", "4767efb", ("GUI/Wasser20l.log",),
        plain("time_s usec temp_air_c set step left heater_duty", every=10), 0.1, 2000.0, 10.0, (), BODY_LIKE,
        note="20 l of water; so much air that what they hold lies within the library's bounds",
        highest_c=105.0,
    ),
    RealLog(
        "reflow oven, two elements", "kept", "windsorschmidt/reflow", "96fc2ec",
        ("plot/reflow_example.log",), triacs, 0.01, 1500.0, 2.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), highest_c=350.0,
    ),
    RealLog(
        "incubator, closed", "dev", "INTO-CPS-Association/example_digital-twin_incubator", "2f08c4f",
        ("software/incubator/datasets/20201221_controller_tunning/exp1_ht3_hg2.csv",),
        table("time", "t2 t3", "heater_on", temp_ambient_c="t1", fan_on="fan_on"), 0.03, 18.7, 3.0,
        HEATER_LIKE, BODY_LIKE, fan="stirring", note="its makers' own model needs the heater's capacity",
    ),
    RealLog(
        "incubator, lid opened", "dev", "INTO-CPS-Association/example_digital-twin_incubator", "2f08c4f",
        ("software/incubator/datasets/20210321_lid_opening_7pmodel/lid_opening_experiment_mar_2021.csv",),
        table("time", "t2 t3", "heater_on", tick_s=1e-9, temp_ambient_c="t1", fan_on="fan_on"), 0.03, 18.7,
        3.0, (*HEATER_LIKE, "door_opening"), BODY_LIKE, fan="stirring",
        note="lid opened seven times for 90 s, as events.csv says; a cup of water stood in it for a while",
    ),
    RealLog(
        "incubator, tempeh", "dev", "INTO-CPS-Association/example_digital-twin_incubator", "2f08c4f",
        ("software/incubator/datasets/20230501_tempeh_batch/rec_2023-05-01__08_09_06.csv",),
        table("time", "t1 t2", "heater_on", tick_s=1e-9, every=10, temp_ambient_c="t3", fan_on="fan_on"),
        0.03, 18.7, 30.0, ("respiration_heat",), (*HEATER_LIKE, *BODY_LIKE, "evapotranspiration"),
        fan="stirring", note="a fungus grows on soaked beans, and keeps it warm once the heater is off",
    ),
    RealLog(
        "heated plate with fan", "dev", "rupakrokade/sbhs-manual", "5aad482",
        ("Scilab/virtual_old/prbs_analysis/prbs.txt",),
        plain("n heater_duty fan temp_air_c time_s server back sent wall", heads=1, tick_s=1e-3, full=100.0),
        1e-3, 20.0, 2.0, HEATER_LIKE, BODY_LIKE, note="the fan runs at half speed throughout",
        highest_c=100.0,
    ),
    RealLog(
        "reflow oven, one element", "kept", "Jbsco/reflow-oven", "72b65b2",
        tuple(
            f"esp_log_{name}_pid_20_0.5_1_new_oven.txt"
            for name in ("7_hold_185", "6_hold_235", "8_SMDLTLFP50T3")
        ),
        lines(
            r"Time: ([\d.]+) s,.* Temp: ([\d.]+) C.* Output: ([\d.]+)",
            "time_s temp_air_c heater_duty", 255.0, 10,
        ),
        0.01, 1500.0, 2.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"), whole=True, highest_c=350.0,
    ),
    RealLog(
        "heater block on a shield", "dev", "gergelytakacs/AutomationShield", "bc0778f",
        ("matlab/examples/HeatShield/resultID2.mat",), heat_shield, 1e-4, 2.3, 4.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), note="10 g of aluminium", highest_c=150.0,
    ),
    RealLog(
        "espresso boiler", "dev", "LukeChannings/gesha", "81fbcaa",
        tuple(f"models/boiler_levels/measurement-history-heat-level-{i}.csv" for i in (10, 4, 8, 2, 6, 9)),
        table("time", "boilerTempC", "heatLevel", tick_s=1e-3, every=22), 5e-3, 1300.0, 4.0, HEATER_LIKE,
        BODY_LIKE, whole=True, note="one pulse a recording, and how it cools", highest_c=160.0,
    ),
    RealLog(
        "coffee roaster", "kept", "scottjames/coffee-roasting", "f797287",
        tuple(
            f"logs/roast_{name}.alog"
            for name in (
                "25-09-21_1350", "25-09-21_1408", "25-09-27_1253_R15", "25-09-27_1433_R16", "25-10-04_1155",
            )
        ),
        roaster, 2e-3, 1500.0, 3.0, (), BODY_LIKE, whole=True,
        note="the beans go in and out, dry and brown", highest_c=300.0,
    ),
    RealLog(
        "multimeter in a box", "dev", "cellularmitosis/logs", "31b3970",
        (
            "20220816-34401a-in-a-box-pid/log-12-pid-kp16-ravg8.csv",
            "20220816-34401a-in-a-box-pid/log-19-pid-kp16-kd4-ravg8-32c-tau0.1.csv",
            "20220816-34401a-in-a-box-pid/log-20-pid-kp16-kd8-ravg8-32c-tau0.1.csv",
        ),
        table("time_s", "int_temp_c", "pwm", full=255.0, every=5, temp_ambient_c="ext_temp_c"), 0.03, 30.0,
        5.0, ("constant_heat", *BODY_LIKE), HEATER_LIKE, whole=True,
        note="the meter is on; the heater is a transistor, which left its sink at some time",
    ),
    RealLog(
        "filament dryer", "dev", "petermaerki/2023_filament_dryer_git", "433d83f",
        ("dryer_experiments/2023-09-11_trials/2023-09-20a_logdata.txt",), dryer, 0.02, 40.0, 10.0,
        HEATER_LIKE, (*BODY_LIKE, "evapotranspiration"), fan="stirring",
        note="silica gel takes up water and gives it off; power a guess", highest_c=120.0,
    ),
    RealLog(
        "printer bed", "kept", "legop3/klipper-ender3-s1", "88b8c49",
        ("printer_data/logs/klippy.log.2025-06-08",), klipper("heater_bed", 2), 2e-3, 270.0, 2.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), highest_c=150.0,
    ),
    RealLog(
        "printer hot end", "dev", "chesleavens/Klipper-logs", "575e9dc", ("klippy.log",),
        klipper("extruder", 1), 1e-4, 40.0, 2.0, HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"),
        note="plastic flows through and a fan blows, which the log does not tell", highest_c=350.0,
    ),
    RealLog(
        "test building of 1983", "dev", "edxu96/BuildingHeatDynamics", "3fb14af",
        ("a4/HeatDynamics_KalmanFilter/Data/data_building.csv",),
        table("timedate", "yTi", "Ph", full=1.5, temp_ambient_c="Ta", solar_w_m2="Gv*1000"), 300.0, 1500.0,
        600.0, BODY_LIKE, ("solar_gain", "constant_heat"),
    ),
    RealLog(
        "lecture hall", "kept", "PREDICT-EPFL/polydome", "4b11071",
        ("dataset/data/raw_2021-10-31_2022-01-14.mat",), hall, 2400.0, 12_000.0, 900.0, BODY_LIKE,
        ("solar_gain", "constant_heat", "ambient_offset", "infiltration"),
        note="heat pump: electric power is metered; up to 200 people; weather from a service",
    ),
    RealLog(
        "hot end of an older printer", "dev", "martinxyz/um-hotend-sim", "8a5e26c", ("temptests.txt",),
        plain("time_s temp_air_c target heater_duty", full=255.0, every=10), 1e-4, 40.0, 2.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), note="a fan is switched on after seven minutes", highest_c=350.0,
    ),
    RealLog(
        "mini greenhouse", "dev", "EfraimManurung/mini-greenhouse-model", "6087f08",
        ("matlab/septemberiotdatasetstestmaturecrops.mat",), greenhouse, 0.15, 60.0, 300.0, (),
        ("evapotranspiration", "solar_gain", "led_gain", "soil_mass", "fan_effectiveness"), fan="exhaust",
        note="grown crops; power a guess",
    ),
    RealLog(
        "air duct", "kept", "daniw/rt-l", "930f51a",
        tuple(
            f"luftkanal/{name}_full.mat" for name in ("06/p_krit", "11/vorsteuerung_step", "06/pid_zn")
        ),
        air_duct, 1e-3, 200.0, 0.1, HEATER_LIKE, BODY_LIKE, whole=True,
        note="air flows through it all the time; power a guess",
    ),
    RealLog(
        "hot end with a fan", "dev", "TehMillhouse/OnionHeater", "df6a2e7", ("heattest_200",),
        fan_calibration, 1e-4, 40.0, 1.0, (*HEATER_LIKE, "stirred_loss"),
        (*BODY_LIKE, "longwave_radiation"), fan="stirring", highest_c=350.0,
        note="full heat and then none, first without its fan and then with it",
    ),
    RealLog(
        "box with two kits, step", "dev", SHARED, "", ("byu_box/step_test.csv",), BYU, 2.5e-3, 4.0, 3.0,
        HEATER_LIKE, BODY_LIKE, note="the heaters' own temperatures lag by 113 to 120 s; whole degrees",
    ),
    RealLog(
        "box with two kits, runs", "dev", SHARED, "",
        tuple(f"byu_box/{name}.csv" for name in ("step_test", "first_run_data", "final_real_run")),
        BYU, 2.5e-3, 4.0, 3.0, HEATER_LIKE, BODY_LIKE, whole=True,
    ),
    RealLog(
        "lab kit, other rooms", "dev", SHARED, "",
        tuple(
            f"tclab_nd/{name}.csv"
            for name in (
                "tclab_step_test",
                "tclab_sine_test_5min_period",
                "validation_experiment_env_2_step_50_run_2",
                "validation_experiment_env_2_sin_5_50_run_2",
                "validation_experiment_env_2_sin_2_50_run_1",
                "validation_experiment_env_2_sin_50_50_run_1",
            )
        ),
        table("Time", "T1", "Q1", full=100.0), 1e-4, 3.6, 3.0, HEATER_LIKE,
        (*BODY_LIKE, "longwave_radiation"), whole=True, note="a run's first reading is its room",
    ),
    RealLog(
        "heating pad, dishes", "dev", SHARED, "", ("myco_pad/202602111639.csv",), pad, 1e-4, 12.0, 10.0,
        (), (*HEATER_LIKE, *BODY_LIKE), note="two wet dishes are put on it after 41 minutes",
    ),
    RealLog(
        "heating pad", "dev", SHARED, "", ("myco_pad/20260303*.csv",), pad, 1e-4, 12.0, 10.0, HEATER_LIKE,
        BODY_LIKE, whole=True, note="in the first a reading jumps by 16.5 K",
    ),
    RealLog(
        "pizza oven, steps", "dev", SHARED, "", ("pizza_oven/*step*.log",), pizza_oven, 0.02, 1500.0, 2.0,
        HEATER_LIKE, (*BODY_LIKE, "longwave_radiation"), whole=True, highest_c=400.0,
    ),
    RealLog(
        "pizza oven, profiles", "dev", SHARED, "", ("pizza_oven/2024-10-*profile*.log",), pizza_oven, 0.02,
        1500.0, 2.0, (*HEATER_LIKE, "door_opening"), (*BODY_LIKE, "longwave_radiation"), whole=True,
        note="the door is opened near the peak, nine minutes after the start", highest_c=400.0,
    ),
)  # fmt: skip
