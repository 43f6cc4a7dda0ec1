"""The instrument: model of the sensors, frames, grades.

The model is y = K β(f, ω): a reading is a sum of functions β of the specific force and the rate, with coefficients K
that the parameters give (`instrument.Instrument.coefficients`). Forward it is `instrument.readings`, inverse
`compensation.Solver`, and its Jacobian `Instrument.derivative`. Without parameters beyond bias, scale factors and axis
angles, K is a matrix and a bias (`model.SensorModel`): forward `predict`, inverse `apply`, Jacobian
`model.Block.jacobian`.
"""
