"""The physics of the box: base energy balance plus named effects; numpy alone, scipy late and only to fit.

`filter` is the Kalman filter, `rollout` runs a twin ahead, `linearise` takes its tangent about recorded rows.
What is done with a twin is elsewhere: predictors in `edge.models`, the search for missing effects in
`edge.diagnosis`, planning in `edge.controllers.twin_plan`.
"""
