"""Use a graph as a sensor model: predict distributions, draw scans, and localize a robot with a particle filter."""

import numpy as np

import sensorgraph as sg

run = sg.record(sg.plan("square", cell=0.5, headings=8))
other = sg.record(sg.plan("square", views=10), seed=1)  # a drive that the graph has not seen
graph = sg.build(run, memory=True)

# What would the laser read at one pose? `rays` limits the work to some rays.
prediction = graph.predict(np.array([[1.0, 2.0, 0.3]]), rays=[0, 90, 180])
low, high = prediction.interval(0.9)
for ray, a, b in zip((0, 90, 180), low[0], high[0], strict=True):
    print(f"ray {ray}: {a:.2f} to {b:.2f} m with a probability of 90 %")
print("three possible readings of ray 90:", np.round(graph.sample([1.0, 2.0, 0.3], 3, rays=[90]).ravel(), 2))

# Where is the robot? Draw 20,000 poses anywhere, and again and again those that fit the first scan, ever more closely. Corners
# look alike, so that poses in several of them are left. Follow 300 of them: the next scans tell the corners apart.
rng = np.random.default_rng(0)
particles = rng.uniform([0.2, 0.2, -np.pi], [3.8, 3.8, np.pi], (20_000, 3))
for width in (0.2, 0.1, 0.05, 0.02):  # [m, rad] each particle stands for the poses around it
    coarse = graph.with_pose_errors(width, width)
    weight = coarse.log_likelihood(other.ranges[0], particles, rays=range(0, 181, 6))
    weight = np.exp(weight - weight.max())
    particles = particles[rng.choice(20_000, 20_000, p=weight / weight.sum())]
    particles += 0.5 * width * rng.normal(size=particles.shape)
particles = particles[:300]

fine = graph.with_pose_errors(0.02, 0.02)
scans = np.arange(0, other.n_scans, 10)
wheels = other.odometry[np.searchsorted(other.odom_stamps, other.stamps[scans], "right") - 1]
errors = []
for k, scan in enumerate(scans):
    if k > 0:
        dx, dy, dphi = wheels[k] - wheels[k - 1]
        turn = particles[:, 2] - wheels[k - 1, 2]
        particles[:, 0] += np.cos(turn) * dx - np.sin(turn) * dy
        particles[:, 1] += np.sin(turn) * dx + np.cos(turn) * dy
        particles[:, 2] += dphi
        particles += 0.01 * rng.normal(size=particles.shape)
    weight = fine.log_likelihood(other.ranges[scan], particles)
    weight = np.exp(weight - weight.max()) / np.exp(weight - weight.max()).sum()
    true = other.poses_at(other.stamps[scan])
    errors.append(np.hypot(*(weight @ particles - true)[:2]))
    particles = particles[rng.choice(300, 300, p=weight)]

after = [f"{100 * errors[k]:.1f} cm after {k + 1} scans" for k in (1, 9)]
print(f"position off by {', '.join(after)}; median {100 * np.median(errors):.1f} cm")
