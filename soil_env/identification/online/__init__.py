"""Online identifier: the soil under a driven wheel, reading by reading.

In the order of docs/physics/estimation.md: `points` averages readings, `cells` points of one
condition. `forces` and `residuals` compare a cell with a soil and its instruments. `fit` finds the
most probable ones, `library` weighs the soils that may come. `borders` passes to another soil.
`best_pull` and `identifier` publish. `memory` has the records, `linear` the algebra, `prior` what
is believed before.

Above stand `class_memory`, `pooling` over the wheels of a rover, `immobilisation` and `ground`,
which says whether the wheel can pass. `on_board` runs all on simulated wheels and rovers,
`interface` on readings of a real wheel.

Constants without another origin are own choices. Those of the estimate were chosen on courses of
their own (docs/physics/estimation.md); least and largest numbers guard logarithms and divisions.
"""
