"""Whole-body control: KinWBC, DynWBC, contacts and the quadratic programs behind them."""
