"""Online identifier: the soil under a driven wheel, reading by reading.

`filter` averages readings to points and renews what is known by each. `curve` keeps the points as a
traction curve, to which `curve_fit` and `soil_nodes` fit the soil. `sinkage_filter` follows the
sinkage, `border` finds borders between soils. `identifier` publishes the estimate
(`filter_estimate`); `pooling` joins the wheels of a rover. `on_board` and `rover_on_board` run it
on the records of simulated vehicles, `interface` on readings of a real one. `lanes` has all
compiled code that these take from elsewhere, and nothing else imports it.
"""
