"""Pictures of a wheel on its course: side view with stresses, charts over time."""
