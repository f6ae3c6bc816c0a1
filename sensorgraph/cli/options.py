"""Arguments and options of the commands, with the help that `sensorgraph COMMAND --help` prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

MAX_VIEWS = 1000
"""More take longer than filling (x, y, φ)."""

# several commands
Topics = Annotated[
    list[str] | None, typer.Option(metavar="ROLE=NAME", help="Topic of a role: scan, pose, odom, cmd.")
]
RobotFile = Annotated[Path | None, typer.Option(help="robot.yaml; default: the shipped robot.")]
GraphFile = Annotated[Path, typer.Argument(metavar="GRAPH", help="A *.sensorgraph file.")]
TopicsByExample = Annotated[list[str] | None, typer.Option(help="ROLE=NAME, for example scan=/front/scan.")]

Force = Annotated[bool, typer.Option("--force", help="Take a run whose poses jump by metres as it is.")]
RunRobot = Annotated[
    Path | None,
    typer.Option(
        "--robot",
        help="robot.yaml of the robot that recorded: its sweep_time, and where its `sensors` sit if the log does not say.",
    ),
]
NoReturn = Annotated[
    str | None,
    typer.Option(help="How the log writes a missing return: range_max, zero, inf or nan; default: noticed."),
]

PosesFrom = Annotated[
    str | None,
    typer.Option(
        "--poses",
        metavar="log|locate",
        help="Take the log's poses, or locate it from scans and wheels; default: locate a run without reference.",
    ),
]

# demo
DemoOut = Annotated[
    Path | None, typer.Option("-o", "--out", help="Folder to write; default: runs/demo-DATE-TIME.")
]
DemoArena = Annotated[str, typer.Option(help="GeoJSON, map_server yaml, or a shipped one.")]
DemoReal = Annotated[
    bool, typer.Option("--real", help="Take a real raw log instead: locate, build, evaluate, review.")
]
DemoSeed = Annotated[int, typer.Option(min=0, help="Of planning and all noise.")]

# plan
PlanArena = Annotated[
    str | None,
    typer.Argument(
        help="GeoJSON, map_server yaml, graph, square or office. Default: the --resume run's, or --graph."
    ),
]
PlanOut = Annotated[Path, typer.Option("-o", "--out", help="Folder to write the plan to.")]
PlanPlanner = Annotated[
    str,
    typer.Option(
        help="coverage, stop_and_spin, views (with --views), or the baselines random_bounce and wall_following."
    ),
]
PlanOrder = Annotated[
    str | None,
    typer.Option(
        metavar="fast|anytime",
        help="fast: the shortest complete drive, room by room. anytime: the whole floor first, then finer, so that "
        "whatever is driven of it shows most; then complete, too. Default: anytime with --budget or --graph (drive: diff), else fast.",
    ),
]
PlanGraph = Annotated[
    Path | None,
    typer.Option(help="A sensorgraph: look first where it would not answer or be wrong (order anytime)."),
]
PlanViews = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MAX_VIEWS,
        help="Instead of filling (x, y, φ), visit so many poses: those that show most surface.",
    ),
]
PlanCell = Annotated[float, typer.Option(help="Side of a position cell, in m.")]
PlanHeadings = Annotated[int, typer.Option(help="Heading bins of a full turn.")]
PlanStart = Annotated[
    str | None, typer.Option(help="X,Y,PHI in m, m, rad; default: where the planner likes.")
]
PlanEnd = Annotated[str | None, typer.Option(help="X,Y,PHI where to end; default: at the last bin.")]
PlanBattery = Annotated[
    float | None,
    typer.Option(metavar="MIN", help="Part the plan into runs so long, each from the dock and back to it."),
]
PlanDock = Annotated[str | None, typer.Option(help="X,Y,PHI of the dock; default: where the plan starts.")]
PlanBudget = Annotated[
    float | None, typer.Option(metavar="MIN", help="Drive so long at most; said is what that covers.")
]
PlanMargin = Annotated[
    float,
    typer.Option(min=0.0, help="What the robot's rim keeps from walls, in m; a wider one reaches less."),
]
PlanJoinPlanner = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="OMPL's planner of ways round obstacles: RRTConnect, BITstar, ..., or yours, module:Class.",
    ),
]
PlanNoGo = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE|x,y,x,y,...",
        help="Where the robot may not enter, and its laser sees through: GeoJSON polygons of kind no_go, or "
        "corners in m; may be repeated.",
    ),
]
PlanDuration = Annotated[
    float | None,
    typer.Option(help="Of random_bounce and wall_following, in s; default: the reference time."),
]
PlanResume = Annotated[
    list[Path] | None, typer.Option(help="A run already driven: plan only what is left. May be repeated.")
]
PlanPriority = Annotated[
    Path | None, typer.Option(help="A sensorgraph: first where it has not been, then where it is unsure.")
]
PlanSeed = Annotated[int, typer.Option(help="Same seed, same bytes.")]

# inspect
InspectFile = Annotated[
    Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV table.")
]
InspectTopic = Annotated[
    list[str] | None,
    typer.Option(help="ROLE=NAME for other names than ours; roles scan, pose, odom, cmd. Repeatable."),
]
InspectArena = Annotated[
    str | None, typer.Option(help="Test the scan against this map; default: the arena kept in the run.")
]
InspectJson = Annotated[Path | None, typer.Option(help="Write the findings there, too.")]

# recover
RecoverFile = Annotated[
    Path, typer.Argument(help="A cut or damaged MCAP file; also the .part of a killed recorder.")
]
RecoverOut = Annotated[Path, typer.Option("-o", "--out", help="Where to write what was saved.")]

# build
BuildRuns = Annotated[
    list[Path], typer.Argument(metavar="RUN...", help="Recordings (MCAP, bag, CARMEN log) with poses.")
]
BuildOutput = Annotated[
    Path, typer.Option("-o", "--out", metavar="GRAPH", help="File to write, *.sensorgraph.")
]
BuildArena = Annotated[
    str | None, typer.Option(help="GeoJSON, map yaml, or a shipped one: its bounds set the scale.")
]
BuildRobot = Annotated[
    Path | None, typer.Option(help="Robot yaml of the robot that recorded; its sensor.sweep_time is taken.")
]
BuildModel = Annotated[
    str, typer.Option(help="faces, cells, polynomial (the form of 2004) or narmax (lags).")
]
BuildSplit = Annotated[str | None, typer.Option(help="Hold scans out: every10 or block.")]
BuildDegree = Annotated[
    str, typer.Option(help="Of polynomial: degree in x and y; of narmax: in poses and twist; or auto.")
]
BuildHarmonics = Annotated[str, typer.Option(help="Of polynomial: harmonics of the heading, or auto.")]
BuildTerms = Annotated[
    str, typer.Option(help="Of polynomial: terms kept for each ray; of narmax: at most; or auto.")
]
BuildLags = Annotated[str, typer.Option(help="Of narmax: scans that it looks back, or auto (3).")]
BuildCalibrate = Annotated[
    bool | None,
    typer.Option(
        "--calibrate/--no-calibrate",
        help="Of faces: identify the laser with them (mount, ray terms, training poses); where it pays.",
    ),
]
BuildMemory = Annotated[bool, typer.Option("--memory", help="Keep how residuals last and spread.")]
BuildUpdate = Annotated[
    Path | None, typer.Option(metavar="GRAPH", help="Add the runs to this graph of faces.")
]
BuildDask = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that reduces the scans of faces."),
]

# locate
LocateRun = Annotated[
    Path, typer.Argument(metavar="RUN", help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")
]
LocateArena = Annotated[
    str | None,
    typer.Option(
        metavar="MAP|GRAPH",
        help="GeoJSON, map_server yaml, a shipped one, or a sensorgraph of the place; default: it is mapped.",
    ),
]
LocateOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", metavar="OUT.mcap", help="The run with /pose, its covariances, and /tf."),
]
LocateCsv = Annotated[
    Path | None,
    typer.Option(
        metavar="POSES.csv", help="Write t,x,y,phi,sigma_x,sigma_y,sigma_phi,status, one row a scan."
    ),
]
LocateJson = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write counts, stretches, wheels and loop closures.")
]
LocatePicture = Annotated[
    Path | None, typer.Option(metavar="PNG", help="Draw returns, track, loop closures kept and refused.")
]

# evaluate
EvaluateRun = Annotated[Path, typer.Argument(metavar="RUN", help="A recording with poses.")]
EvaluateSplit = Annotated[
    str | None, typer.Option(help="Score only scans that this split holds out: every10 or block.")
]
EvaluateCap = Annotated[
    float | None,
    typer.Option(help="Longest return that counts, in m; default: 10, or the sensor's range."),
]
EvaluatePoint = Annotated[
    str | None,
    typer.Option(help="Point value for all numbers: mode, median or mean [default: each its own]"),
]
EvaluateEffects = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="effects.yaml: score the simulator too, as mapped and amended."),
]
EvaluateBeside = Annotated[
    list[Path] | None,
    typer.Option("--beside", metavar="GRAPH", help="Score this graph on the same rays, too."),
]
EvaluateJson = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all numbers here.")]

# predict
PredictPoses = Annotated[Path, typer.Option(help="CSV with columns x,y,phi in m, m, rad.")]
PredictOutput = Annotated[Path, typer.Option("-o", "--out", metavar="NPZ", help="File to write.")]
PredictPoint = Annotated[str, typer.Option(help="Which value `ranges` is: mode, median or mean.")]

# show
ShowRay = Annotated[
    int | None, typer.Option(metavar="INDEX", help="Print the equation of this ray, given by index.")
]
Bearing = Annotated[
    float | None,
    typer.Option(
        metavar="DEG", help="The ray that looks there from the robot: 0 ahead, counter-clockwise, in degrees."
    ),
]
ShowFigure = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out",
        metavar="PNG",
        help="Draw faces, visibility and what was never looked through, *.png.",
    ),
]
ShowRun = Annotated[
    Path | None, typer.Option(help="With --out: a run whose mean residuals are drawn on the faces.")
]

# review
ReviewRun = Annotated[Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")]
ReviewOut = Annotated[Path, typer.Option("-o", "--out", help="The review to write, *.rrd.")]
ReviewGraph = Annotated[Path | None, typer.Option(help="A sensorgraph to hold against the run.")]
ReviewPlan = Annotated[Path | None, typer.Option(help="The plan's folder: its path is drawn too.")]
ReviewArena = Annotated[str | None, typer.Option(help="Walls to draw; default: the arena kept in the run.")]
ReviewRay = Annotated[
    int | None,
    typer.Option(metavar="INDEX", help="The ray whose series is shown; default: straight ahead."),
]
ReviewShow = Annotated[bool, typer.Option("--show", help="Open it in rerun's viewer when done.")]
ReviewServe = Annotated[
    bool, typer.Option("--serve", help="Serve it to a browser on this machine when done, until Ctrl-C.")
]

# diagnose
DiagnoseRuns = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="A run; a second one of the same place is used for nothing but the proof.",
    ),
]
DiagnoseArena = Annotated[
    str | None,
    typer.Option(help="GeoJSON, map_server yaml, or a shipped one; default: the one kept in the run."),
]
DiagnoseRobot = Annotated[Path | None, typer.Option(help="robot.yaml; default: the one kept in the run.")]
DiagnoseOut = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the report.")]
DiagnoseEffects = Annotated[
    Path | None, typer.Option(help="effects.yaml: effects that are part of the model already.")
]
DiagnoseCommissioning = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="RUN",
        help="A run of the same robot and place that is known to be good; what differs from it is found. "
        "Repeat it for several: they show how far good runs spread.",
    ),
]
DiagnoseSimulation = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN",
        help="A log of your own simulator (Gazebo, Isaac, MuJoCo, ir-sim, ...) in the same arena; what differs between "
        "the two is found, whatever both share is not.",
    ),
]
DiagnoseSeed = Annotated[int, typer.Option(min=0, help="Of the replicates: same seed, same report.")]

# identify
IdentifyFile = Annotated[
    Path,
    typer.Argument(metavar="FILE", help="A CSV with columns by name (`record` separates records), or a run."),
]
IdentifyOutput = Annotated[list[str], typer.Option(metavar="NAME", help="The signal to explain; one.")]
IdentifyOut = Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.json", help="The model to write.")]
IdentifyInputs = Annotated[
    str, typer.Option(metavar="NAME,...", help="The signals that explain it, separated by commas.")
]
IdentifyLags = Annotated[int, typer.Option(min=0, max=1000, help="Inputs at k, k-1, ..., k-N.")]
IdentifyOutputLags = Annotated[int, typer.Option(min=0, max=1000, help="Past outputs k-1, ..., k-N.")]
IdentifyDegree = Annotated[int, typer.Option(min=1, max=8, help="Of the polynomial.")]
IdentifyNoiseLags = Annotated[
    str, typer.Option(metavar="N|auto", help="Past noise e(k-1), ..., e(k-N); auto: as many as it takes.")
]
IdentifySplit = Annotated[str, typer.Option(help="half: first half trains; block: every second tenth; none.")]
IdentifyEvery = Annotated[int, typer.Option(min=1, help="Use every K-th sample.", metavar="K")]
IdentifyCriterion = Annotated[str | None, typer.Option(help="Of size: bic, aic, ebic, cv, err_tol, n_terms.")]
IdentifyTerms = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Terms to keep, or the most to look at.")
]
IdentifyAuto = Annotated[bool, typer.Option("--auto", help="Choose lags, degree and terms for free run.")]

# record
RecordPlan = Annotated[
    Path | None,
    typer.Argument(help="A plan's folder, its trajectory.csv, or a run whose /cmd_vel is driven again."),
]
RecordOut = Annotated[Path, typer.Option("-o", "--out", help="The run to write, *.mcap.")]
RecordArena = Annotated[
    str | None,
    typer.Option(help="GeoJSON, map_server yaml, or a shipped one: square, office; default: the plan's."),
]
RecordRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml; default: the plan's, else the shipped robot.")
]
RecordGraph = Annotated[
    Path | None,
    typer.Option(metavar="GRAPH", help="Drive in the world that a sensorgraph has identified."),
]
RecordController = Annotated[
    list[str] | None,
    typer.Option(
        help="plan, wall_following, random_bounce, a MODEL.json of `identify`, or TURN.json,SPEED.json; "
        "several are compared."
    ),
]
RecordStart = Annotated[
    str | None, typer.Option(help="X,Y,PHI in m, m, rad: where a replay of commands begins.")
]
RecordEffects = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="effects.yaml: what robot, sensor and room have beyond the map."),
]
RecordSeed = Annotated[int, typer.Option(min=0, help="Of all noise: same seed, same bytes.")]

# export
ExportSource = Annotated[
    str,
    typer.Argument(
        metavar="GRAPH|ARENA",
        help="A *.sensorgraph of faces, a GeoJSON, a map_server yaml, or a shipped arena: square, office.",
    ),
]
ExportTarget = Annotated[str, typer.Option("--to", metavar="TARGET", help="mujoco, irsim, gazebo or nav2.")]
ExportOut = Annotated[Path, typer.Option("-o", "--out", help="Folder to write.")]
ExportEffects = Annotated[
    Path | None, typer.Option(metavar="FILE", help="effects.yaml: built in, as far as the target can.")
]
ExportRun = Annotated[
    Path | None, typer.Option(help="A run that AMCL's parameters are estimated from (nav2).")
]
ExportNoGo = Annotated[
    list[str] | None,
    typer.Option(help="Zones for the keepout mask (nav2): GeoJSON of kind no_go, or corners x,y,x,y,x,y."),
]
WallHeight = Annotated[
    float | None, typer.Option(help="[m] Height of the walls; default: half a metre above the laser.")
]
