"""The project's own primal-dual interior-point method, in compiled code."""
