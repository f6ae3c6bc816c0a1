"""The own world: rooms, ray caster, robot and physics by this project, separate from the product."""
