"""Arguments and options of the commands, one table, with the help that `sensorgraph COMMAND --help` prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

MAX_VIEWS = 1000
"""A plan of more views takes longer than covering (x, y, φ)."""

# several commands
Topics = Annotated[
    list[str] | None,
    typer.Option(metavar="ROLE=NAME", help="Topic to read for a role (scan, pose, odom, cmd); repeatable."),
]
RobotFile = Annotated[Path | None, typer.Option(help="robot.yaml; default: the shipped robot.")]
GraphFile = Annotated[Path, typer.Argument(metavar="GRAPH", help="Sensorgraph, *.sensorgraph.")]
TopicsByExample = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ROLE=NAME", help="Topic to read for a role, for example scan=/front/scan; repeatable."
    ),
]

Force = Annotated[bool, typer.Option("--force", help="Accept a run whose poses jump by metres.")]
RunRobot = Annotated[
    Path | None,
    typer.Option(
        "--robot",
        help="robot.yaml of the recording robot: the ray times and mounts that it states replace those of the log.",
    ),
]
NoReturn = Annotated[
    str | None,
    typer.Option(
        help="Value of a missing return in the log: range_max, zero, inf or nan; default: detected."
    ),
]

Slice = Annotated[
    str | None,
    typer.Option(
        "--slice",
        metavar="Z0,Z1",
        help="Read a point cloud as a laser: its points from Z0 to Z1 (m) above base_footprint, or else base_link. "
        "Default: the ring nearest the horizontal.",
    ),
]

PosesFrom = Annotated[
    str | None,
    typer.Option(
        "--poses",
        metavar="log|locate",
        help="log: use the poses in the log. locate: estimate them from scans and wheels. "
        "Default: locate if the log has no reference poses.",
    ),
]

# demo
DemoOut = Annotated[
    Path | None, typer.Option("-o", "--out", help="Folder for the results; default: runs/demo-DATE-TIME.")
]
DemoArena = Annotated[
    str, typer.Option(help="GeoJSON file, map_server yaml, or a shipped arena: square, office.")
]
DemoFull = Annotated[
    bool,
    typer.Option("--full", help="Compare with a random drive of the same length and with the model of 2004."),
]
DemoReal = Annotated[
    bool, typer.Option("--real", help="Use a shipped real log instead: locate, build, evaluate, review.")
]
DemoSeed = Annotated[int, typer.Option(min=0, help="Random seed of planning and noise.")]

# plan
PlanArena = Annotated[
    str | None,
    typer.Argument(
        help="GeoJSON file, map_server yaml, sensorgraph, square or office; "
        "default: the arena kept in the --resume run, else that of --graph."
    ),
]
PlanRobot = Annotated[
    Path | None,
    typer.Option(help="robot.yaml; default: the robot kept in the --resume run, else the shipped robot."),
]
PlanOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the plan.")]
PlanPlanner = Annotated[
    str,
    typer.Option(
        help="coverage, stop_and_spin, views (with --views), or a baseline: random_bounce, wall_following."
    ),
]
PlanOrder = Annotated[
    str | None,
    typer.Option(
        metavar="fast|anytime",
        help="fast: shortest complete drive, room by room. anytime: the whole floor coarsely, then finer until complete, "
        "so that a drive cut short shows the most. Default: anytime with --budget or --graph (drive: diff), else fast.",
    ),
]
PlanGraph = Annotated[
    Path | None,
    typer.Option(help="A sensorgraph: look first where its expected error is highest (order anytime)."),
]
PlanViews = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MAX_VIEWS,
        help="Visit this number of poses that see the most surface, instead of covering (x, y, φ).",
    ),
]
PlanCell = Annotated[float, typer.Option(help="Side of a position cell (m).")]
PlanHeadings = Annotated[int, typer.Option(help="Number of heading bins in a full turn.")]
PlanStart = Annotated[
    str | None,
    typer.Option(
        help="Start pose X,Y,PHI (m, m, rad, or with units: 90 deg); default: chosen by the planner."
    ),
]
PlanEnd = Annotated[str | None, typer.Option(help="End pose X,Y,PHI (m, m, rad); default: at the last bin.")]
PlanBattery = Annotated[
    float | None,
    typer.Option(
        metavar="MIN", help="Split the plan into runs of this many minutes, from the dock and back."
    ),
]
PlanDock = Annotated[
    str | None, typer.Option(help="Dock pose X,Y,PHI (m, m, rad); default: the start of the plan.")
]
PlanBudget = Annotated[
    float | None,
    typer.Option(metavar="MIN", help="Limit the drive to this many minutes and report its coverage."),
]
PlanMargin = Annotated[
    float,
    typer.Option(min=0.0, help="Clearance between robot and walls (m); a larger margin reaches fewer bins."),
]
PlanJoinPlanner = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="OMPL planner for paths around obstacles: RRTConnect, BITstar, ..., or your own as module:Class.",
    ),
]
PlanNoGo = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE|x,y,x,y,...",
        help="Zone that the robot must not enter but can see through: GeoJSON polygons of kind no_go, or "
        "corners (m); repeatable.",
    ),
]
PlanDuration = Annotated[
    float | None,
    typer.Option(help="Duration of random_bounce and wall_following (s); default: the reference time."),
]
PlanResume = Annotated[
    list[Path] | None, typer.Option(help="Run already driven: plan only the bins it missed; repeatable.")
]
PlanPriority = Annotated[
    Path | None,
    typer.Option(help="A sensorgraph: drive first where it does not answer, then where it is least certain."),
]
PlanSeed = Annotated[int, typer.Option(help="Random seed; the same seed gives the same plan.")]

# inspect
InspectFile = Annotated[
    Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log, CSV table, or a map.")
]
InspectTopic = Annotated[
    list[str] | None,
    typer.Option(metavar="ROLE=NAME", help="Topic to read for a role (scan, pose, odom, cmd); repeatable."),
]
InspectArena = Annotated[
    str | None,
    typer.Option(
        help="Map to check the orientation of the scan against; default: the arena kept in the run."
    ),
]
InspectJson = Annotated[Path | None, typer.Option(help="Also write the findings to this JSON file.")]

InspectPolicy = Annotated[
    Path | None,
    typer.Option(
        "--policy",
        help="Limits of `watch --init-policy` for topics, rates, gaps and stamps; they decide the exit code: 0 ok, "
        "1 warning, 2 error.",
    ),
]

# recover
RecoverFile = Annotated[
    Path,
    typer.Argument(
        help="Truncated or damaged MCAP file or ROS 1 bag, also the .part or .active file of a killed recorder."
    ),
]
RecoverOut = Annotated[Path, typer.Option("-o", "--out", help="MCAP file for the recovered messages.")]

# build
BuildRuns = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...", help="Runs of one sensor: MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV."
    ),
]
BuildOutput = Annotated[
    Path, typer.Option("-o", "--out", metavar="GRAPH", help="Sensorgraph to write, *.sensorgraph.")
]
BuildArena = Annotated[
    str | None,
    typer.Option(help="GeoJSON file, map_server yaml, or a shipped arena; its bounds scale x and y."),
]
BuildRobot = Annotated[
    Path | None,
    typer.Option(
        help="robot.yaml of the recording robot: the ray times and mounts that it states replace those of the log."
    ),
]
BuildModel = Annotated[
    str, typer.Option(help="faces, cells, polynomial (published in 2004) or narmax (uses past scans).")
]
BuildSplit = Annotated[
    str | None, typer.Option(help="Hold scans out for evaluation: every10 or block; default: none.")
]
BuildDegree = Annotated[
    str,
    typer.Option(help="Degree in x and y (polynomial), or in poses and twist (narmax); or auto."),
]
BuildHarmonics = Annotated[
    str, typer.Option(help="Number of harmonics of the heading (polynomial), or auto.")
]
BuildTerms = Annotated[
    str, typer.Option(help="Number of terms of each ray (polynomial), or their maximum (narmax); or auto.")
]
BuildLags = Annotated[str, typer.Option(help="Number of past scans (narmax), or auto (3).")]
BuildCalibrate = Annotated[
    bool | None,
    typer.Option(
        "--calibrate/--no-calibrate",
        help="Estimate the laser with the faces: mount, ray terms, training poses; default: if it improves the fit.",
    ),
]
BuildMemory = Annotated[
    bool,
    typer.Option("--memory", help="Also identify the correlation of residuals in time and between rays."),
]
BuildUpdate = Annotated[
    Path | None, typer.Option(metavar="GRAPH", help="Add the runs to this sensorgraph (model faces).")
]
BuildDask = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Address of a Dask scheduler that reduces the scans (model faces)."),
]

# locate
LocateRun = Annotated[
    Path, typer.Argument(metavar="RUN", help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")
]
LocateArena = Annotated[
    str | None,
    typer.Option(
        metavar="MAP|GRAPH",
        help="Known place: GeoJSON file, map_server yaml, log with /map, shipped arena or sensorgraph; default: build a map.",
    ),
]
LocateOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", metavar="OUT.mcap", help="Run to write, with /pose, covariances and /tf."),
]
LocateCsv = Annotated[
    Path | None,
    typer.Option(
        metavar="POSES.csv",
        help="Write t,x,y,phi,sigma_x,sigma_y,sigma_phi,status,map to this file, one row per scan.",
    ),
]
LocateJson = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write scan counts, located intervals, wheel parameters and loop closures."
    ),
]
LocatePicture = Annotated[
    Path | None,
    typer.Option(metavar="PNG", help="Draw returns, trajectory, and accepted and rejected loop closures."),
]

# evaluate
EvaluateRun = Annotated[
    Path, typer.Argument(metavar="RUN", help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")
]
EvaluateSplit = Annotated[
    str | None, typer.Option(help="Score only the held-out scans of this split: every10 or block.")
]
EvaluateCap = Annotated[
    float | None,
    typer.Option(help="Longest return that is scored (m); default: 10, or the sensor's range if shorter."),
]
EvaluatePoint = Annotated[
    str | None,
    typer.Option(
        help="Point value for all scores: mode, median or mean; default: the best one for each score."
    ),
]
EvaluateEffects = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="effects.yaml: also score the simulator, without and with these effects."
    ),
]
EvaluateBeside = Annotated[
    list[Path] | None,
    typer.Option(
        "--beside", metavar="GRAPH", help="Also score this sensorgraph on the same rays; repeatable."
    ),
]
EvaluateJson = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Also write all scores to this JSON file.")
]

# predict
PredictPoses = Annotated[Path, typer.Option(help="CSV with columns x,y,phi (m, m, rad).")]
PredictOutput = Annotated[Path, typer.Option("-o", "--out", metavar="NPZ", help="File to write, *.npz.")]
PredictPoint = Annotated[str, typer.Option(help="Point value in `ranges`: mode, median or mean.")]

# show
ShowRay = Annotated[
    int | None, typer.Option(metavar="INDEX", help="Print the equation of the ray with this index.")
]
ShowAll = Annotated[
    bool,
    typer.Option(
        "--all", help="Print all faces of the ray, also those that stop it at less than 1 % of poses."
    ),
]
Bearing = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="Select the ray by its bearing from the robot (degrees): 0 ahead, 90 to the left.",
    ),
]
ShowFigure = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out",
        metavar="PNG",
        help="Draw faces, visibility and unobserved space to this *.png file.",
    ),
]
ShowRun = Annotated[
    Path | None, typer.Option(help="With --out: run whose mean residuals are drawn on the faces.")
]

# review
ReviewRun = Annotated[Path, typer.Argument(help="MCAP, rosbag2 folder, ROS 1 bag, CARMEN log or CSV.")]
ReviewOut = Annotated[Path, typer.Option("-o", "--out", help="Rerun file to write, *.rrd.")]
ReviewGraph = Annotated[Path | None, typer.Option(help="Sensorgraph to compare with the run.")]
ReviewPlan = Annotated[Path | None, typer.Option(help="Folder of a plan whose path is drawn.")]
ReviewArena = Annotated[
    str | None, typer.Option(help="Arena whose walls are drawn; default: the arena kept in the run.")
]
ReviewRay = Annotated[
    int | None,
    typer.Option(metavar="INDEX", help="Ray whose time series is shown; default: straight ahead."),
]
ReviewShow = Annotated[bool, typer.Option("--show", help="Open the review in rerun's viewer.")]
ReviewServe = Annotated[
    bool, typer.Option("--serve", help="Serve the review to a browser on this machine until Ctrl-C.")
]

# diagnose
DiagnoseRuns = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="Run to diagnose; a second run of the same place serves only to verify the result.",
    ),
]
DiagnoseArena = Annotated[
    str | None,
    typer.Option(
        help="GeoJSON file, map_server yaml, log with /map, or a shipped arena; default: the arena kept in the run."
    ),
]
DiagnoseRobot = Annotated[
    Path | None,
    typer.Option(
        help="robot.yaml; default: the robot kept in the run. The sensor's unstated values are those of the run."
    ),
]
DiagnoseOut = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the report.")]
DiagnoseEffects = Annotated[
    Path | None, typer.Option(help="effects.yaml with effects that the simulation already includes.")
]
DiagnoseCommissioning = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="RUN",
        help="Run of the same robot and place that is known to be good; only differences from it are reported. "
        "Repeatable: several good runs show their normal spread.",
    ),
]
DiagnoseSimulation = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN",
        help="Log of your own simulator (Gazebo, Isaac, MuJoCo, ir-sim, ...) in the same arena; only differences "
        "between the two logs are reported.",
    ),
]
DiagnoseSeed = Annotated[
    int, typer.Option(min=0, help="Random seed of the simulated replicates; same seed, same report.")
]
DiagnoseWhy = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Also explain why this effect, or family of differences, was or was not named."
    ),
]

# why
WhyReport = Annotated[
    Path, typer.Argument(metavar="REPORT", help="Folder of a diagnosis, or its report.json.")
]
WhyName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Effect, or family of differences that no effect explains."),
]

# identify
IdentifyFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="Run, or CSV with named columns (a column `record` separates records)."
    ),
]
IdentifyOutput = Annotated[list[str], typer.Option(metavar="NAME", help="Signal to explain.")]
IdentifyOut = Annotated[
    Path, typer.Option("-o", "--out", metavar="MODEL.json", help="Model file to write, *.json.")
]
IdentifyInputs = Annotated[
    str, typer.Option(metavar="NAME,...", help="Signals that explain the output, separated by commas.")
]
IdentifyLags = Annotated[
    int, typer.Option(min=0, max=1000, metavar="N", help="Input lags: use inputs at k, k-1, ..., k-N.")
]
IdentifyOutputLags = Annotated[
    int, typer.Option(min=0, max=1000, metavar="N", help="Output lags: use outputs at k-1, ..., k-N.")
]
IdentifyDegree = Annotated[int, typer.Option(min=1, max=8, help="Degree of the polynomial.")]
IdentifyNoiseLags = Annotated[
    str,
    typer.Option(
        metavar="N|auto", help="Noise lags: use e(k-1), ..., e(k-N); auto: chosen from the residual."
    ),
]
IdentifySplit = Annotated[
    str,
    typer.Option(
        metavar="half|block|none",
        help="Test data: half (the second half), block (every second tenth) or none (the training data).",
    ),
]
IdentifyEvery = Annotated[int, typer.Option(min=1, help="Use every K-th sample.", metavar="K")]
IdentifyCriterion = Annotated[
    str | None, typer.Option(help="Selects the number of terms: bic, aic, ebic, cv, err_tol or n_terms.")
]
IdentifyTerms = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Number of terms, or their maximum with --criterion.")
]
IdentifyAuto = Annotated[
    bool, typer.Option("--auto", help="Choose lags, degree and terms with the best free run.")
]

# record
RecordPlan = Annotated[
    Path | None,
    typer.Argument(help="Folder of a plan, its trajectory.csv, or a run whose /cmd_vel is replayed."),
]
RecordOut = Annotated[Path, typer.Option("-o", "--out", help="Run to write, *.mcap.")]
RecordArena = Annotated[
    str | None,
    typer.Option(
        help="GeoJSON file, map_server yaml, or a shipped arena: square, office; default: the arena of the plan."
    ),
]
RecordRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml; default: the robot of the plan, else the shipped robot.")
]
RecordGraph = Annotated[
    Path | None,
    typer.Option(metavar="GRAPH", help="Drive in the identified world of this sensorgraph."),
]
RecordController = Annotated[
    list[str] | None,
    typer.Option(
        help="plan, wall_following, random_bounce, a MODEL.json of `identify`, or TURN.json,SPEED.json; "
        "repeatable, to compare controllers."
    ),
]
RecordStart = Annotated[
    str | None,
    typer.Option(
        help="Start pose X,Y,PHI (m, m, rad, or with units: 90 deg) of a controller or of a replay of commands; "
        "default: that of the plan or of the run."
    ),
]
RecordEffects = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="effects.yaml: effects of robot, sensor and environment to simulate."),
]
RecordSeed = Annotated[int, typer.Option(min=0, help="Random seed of all noise; same seed, same bytes.")]

# fleet
FleetLogs = Annotated[
    list[str], typer.Argument(metavar="LOG|FOLDER|PATTERN...", help="Logs, folders with logs, or patterns.")
]
FleetOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
FleetGraph = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GRAPH",
        help="Sensorgraph of a place; repeatable. Default: each log is located in a new map.",
    ),
]
FleetArena = Annotated[
    list[str] | None,
    typer.Option(metavar="MAP", help="GeoJSON file or map_server yaml of a place; repeatable."),
]
FleetRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml of all robots; default: the one kept in each log.")
]
FleetPattern = Annotated[
    str | None,
    typer.Option(
        metavar="REGEX",
        help="Robot's name in the path of a log. Default: robot.yaml in the log, the prefix of the laser's frame, or the folder.",
    ),
]
FleetScheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler whose workers read the same paths; default: this machine."
    ),
]
FleetWorkers = Annotated[
    int | None, typer.Option(min=1, help="Logs at a time on this machine; default: one for each processor.")
]
FleetMinutes = Annotated[float, typer.Option(min=0.01, help="Maximum time of a log (min).")]
FleetMemory = Annotated[float, typer.Option(min=100, help="Maximum memory of a log's process (MB).")]

# amend
AmendFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...",
        help="URDF, xacro with its includes, SDF, MJCF, nav2_params.yaml or robot.yaml.",
    ),
]
AmendEffects = Annotated[Path, typer.Option(metavar="FILE", help="effects.yaml, as `diagnose` writes it.")]
AmendRun = Annotated[
    Path | None,
    typer.Option(
        help="Run whose rate, angles and ranges of the laser are written; for Nav2, also AMCL's parameters."
    ),
]
AmendArena = Annotated[
    str | None,
    typer.Option(help="Map of the run, for AMCL's parameters; default: the arena kept in the run."),
]
AmendLaser = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Sensor, link, body or site of the laser, if there are several."),
]
AmendOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", help="File, or folder for several files; default: replace the given files."),
]
AmendDryRun = Annotated[bool, typer.Option("--dry-run", help="Print the changes, and write nothing.")]

# export
ExportSource = Annotated[
    str,
    typer.Argument(
        metavar="GRAPH|ARENA",
        help="Sensorgraph (model faces), GeoJSON file, map_server yaml, or a shipped arena: square, office.",
    ),
]
ExportTarget = Annotated[
    str, typer.Option("--to", metavar="TARGET", help="Target: mujoco, irsim, gazebo or nav2.")
]
ExportOut = Annotated[Path, typer.Option("-o", "--out", help="Folder for the exported files.")]
ExportEffects = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="effects.yaml: effects to build in, as far as the target supports them."
    ),
]
ExportRobot = Annotated[
    Path | None,
    typer.Option(
        "--robot",
        help="robot.yaml; default: the robot of --run, else the shipped one with the laser of the sensorgraph.",
    ),
]
ExportRun = Annotated[
    Path | None, typer.Option(help="nav2: run from which the AMCL parameters are estimated.")
]
ExportNoGo = Annotated[
    list[str] | None,
    typer.Option(
        help="nav2: keepout zone, as GeoJSON of kind no_go or as corners x,y,x,y,x,y (m); repeatable."
    ),
]
WallHeight = Annotated[
    float | None, typer.Option(help="Height of the walls (m); default: 0.5 m above the laser.")
]
