"""Find the hidden effect: what is missing in the simulator, how large it is, and how sure that is."""

from pathlib import Path

import sensorgraph as sg

here = Path(__file__).parent
plan = sg.plan(here / "lab.geojson", here / "robot.yaml", views=12)

# Something is wrong with this robot: its laser was remounted, a degree off. Nobody tells the diagnosis.
Path("truth.yaml").write_text("- {name: mount_yaw, parameters: {delta: 0.0175}}\n")
today = sg.record(plan, effects="truth.yaml", seed=1)
tomorrow = sg.record(plan, effects="truth.yaml", seed=2)

# The first run is explained; the second is used for nothing but the proof.
finding = sg.diagnose(today, tomorrow)
for effect in finding.effects:
    print(f"{effect.name}, with probability {effect.probability:.2f}")
    for name, value in effect.parameters.items():
        print(f"  {name} = {value:.4f} +- {effect.stderr[name]:.4f}")

finding.save("diagnosis")  # the report, and its pictures

gap = finding.second_gap
print(f"gap on the second run: {100 * gap.before.rmse_m:.2f} cm -> {100 * gap.after.rmse_m:.2f} cm")
print(f"noise alone would leave: {100 * gap.noise_floor.rmse_m:.2f} cm")

# With the finding in the simulator, nothing is left to find.
again = sg.diagnose(today, effects=finding.effects)
print("and with that in the model:", [effect.name for effect in again.effects] or "nothing to report")

# A run of a robot that is in order: the tolerances of a careful set-up explain it.
print(
    "a good robot:",
    [effect.name for effect in sg.diagnose(sg.record(plan, seed=3)).effects] or "nothing to report",
)
