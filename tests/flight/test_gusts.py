import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import welch

from aerotube.errors import InputError
from aerotube.flight import Dryden, draw

FOOT = 0.3048
SPAN = 9.144
CASES = st.builds(
    Dryden,
    severity=st.sampled_from(["light", "moderate", "severe"]),
    altitude=st.floats(30, 12000),
    speed=st.floats(40, 300),
    span=st.floats(1, 40),
)


def variances(gust):
    # Substitute omega = e^y: the spectra spread over decades.
    return [
        quad(lambda y, i=i: np.exp(y) * gust.spectrum(np.exp(y))[i], -25, 25, limit=400, epsabs=0, epsrel=1e-9)[0]
        for i in range(6)
    ]


@settings(max_examples=6, deadline=None)
@given(CASES)
def test_stationary_covariance_is_the_integral_of_the_published_spectra(gust):
    np.testing.assert_allclose(np.diag(gust.covariance()), variances(gust), rtol=1e-5, atol=1e-16)
    np.testing.assert_allclose(np.diag(gust.covariance())[:3], gust.intensity**2, rtol=1e-9, atol=1e-16)


def test_published_intensities_and_scales():
    low = Dryden("moderate", 500 * FOOT, 100, SPAN)
    ratio = 0.177 + 0.000823 * 500
    vertical = 3.0 * 1852 / 3600
    np.testing.assert_allclose(low.intensity, [vertical / ratio**0.4] * 2 + [vertical], rtol=1e-12)
    np.testing.assert_allclose(low.scale / FOOT, [500 / ratio**1.2] * 2 + [500], rtol=1e-12)
    for severity, feet in (("light", 6.7), ("moderate", 10.1), ("severe", 23.6)):
        high = Dryden(severity, 7500 * FOOT, 100, SPAN)
        np.testing.assert_allclose(high.intensity / FOOT, feet, rtol=1e-12)
        np.testing.assert_allclose(high.scale / FOOT, 1750, rtol=1e-12)


@pytest.mark.parametrize("feet", [1000.0, 2000.0])
def test_the_layers_join(feet):
    below, above = (Dryden("severe", feet * FOOT * (1 + side * 1e-9), 100, SPAN) for side in (-1, 1))
    np.testing.assert_allclose(below.intensity, above.intensity, rtol=1e-6)
    np.testing.assert_allclose(below.scale, above.scale, rtol=1e-6)


@pytest.mark.parametrize("dt", [0.05, 1.0])
def test_samples_have_the_statistics_of_the_process_whatever_the_step(dt):
    gust = Dryden("moderate", 3000, 185, SPAN)
    runs, times = 4000, 6
    wind = gust.sample(draw(np.zeros(8), [11], runs).gust_noise(times, 8), dt)
    expected = gust.covariance()
    scale = np.sqrt(np.diag(expected))
    for k in (0, times - 1):
        sampled = wind[:, k].T @ wind[:, k] / runs
        # A sample correlation of 4000 has a standard error of at most sqrt(2 / 4000); 5 of them.
        assert np.max(np.abs((sampled - expected) / np.outer(scale, scale))) < 5 * np.sqrt(2 / runs)
    # Correlation over time of the longitudinal gust: exp(-V t / L).
    lag = np.mean(wind[:, 0, 0] * wind[:, -1, 0]) / expected[0, 0]
    assert lag == pytest.approx(np.exp(-185 * dt * (times - 1) / gust.scale[0]), abs=5 * np.sqrt(2 / runs))


def test_spectrum_of_samples_is_the_published_one():
    gust = Dryden("severe", 3000, 185, SPAN)
    dt, runs, times = 0.02, 100, 4096
    wind = gust.sample(draw(np.zeros(8), [12], runs).gust_noise(times, 8), dt)
    hertz, density = welch(wind, fs=1 / dt, nperseg=1024, axis=1)
    # Well inside the Nyquist frequency (aliasing) and above the window's resolution.
    band = (hertz > 0.3) & (hertz < 4)
    measured = density.mean(0)[band] / (2 * np.pi)
    ratio = measured / gust.spectrum(2 * np.pi * hertz[band])
    # Some 700 half-overlapping segments, 75 frequencies in the band: means over the band are known to 1 %.
    np.testing.assert_allclose(ratio.mean(0), 1.0, atol=0.04)
    assert np.all((ratio > 0.75) & (ratio < 1.35))


def test_rotation_is_the_gradient_of_the_velocity():
    # With the velocity smoothed by the lag of its filter, w_s + tau w_s' = w, the rotation is q = -w_s' / V and
    # r = v_s' / V: so V times the integral of q is the change of -(w + tau V q), and likewise for r.
    speed = 185.0
    gust = Dryden("moderate", 3000, speed, SPAN)
    dt = 1e-3
    wind = gust.sample(draw(np.zeros(8), [13], 10).gust_noise(3000, 8), dt)
    for rotation, velocity, sign, arm in ((4, 2, -1.0, 4.0), (5, 1, 1.0, 3.0)):
        rate = wind[:, :, rotation]
        smoothed = sign * wind[:, :, velocity] - arm * SPAN / np.pi * rate
        integral = speed * dt * np.cumsum(0.5 * (rate[:, 1:] + rate[:, :-1]), axis=1)
        # The trapezoidal rule errs by a random walk: sqrt(D dt^3 / 12) a step for a signal that diffuses by D.
        diffusion = 3 * (gust.intensity[1] * np.pi * speed / (arm * SPAN)) ** 2 * speed / gust.scale[1]
        walk = np.sqrt(diffusion * dt**3 / 12 * rate.shape[1])
        assert smoothed.std() > 30 * walk
        np.testing.assert_allclose(integral, smoothed[:, 1:] - smoothed[:, :1], atol=6 * walk, rtol=0)


def test_a_run_keeps_its_gusts_in_any_batch():
    gust = Dryden("light", 3000, 185, SPAN)
    normals = draw(np.zeros(8), range(3), 50).gust_noise(30, 8)
    np.testing.assert_array_equal(gust.sample(normals, 0.05)[60:63], gust.sample(normals[60:63], 0.05))


def test_calm_above_the_weather():
    gust = Dryden("light", 40000, 185, SPAN)
    assert not gust.sample(draw(np.zeros(8), [0], 2).gust_noise(3, 8), 0.05).any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("strong", 3000, 185, SPAN), "light, moderate, severe"),
        (("light", 0.0, 185, SPAN), "altitude must be positive"),
        (("light", 3000, np.nan, SPAN), "speed must be positive"),
        (("light", 3000, 185, -1), "span must be positive"),
    ],
)
def test_mistakes_are_named(arguments, words):
    with pytest.raises(InputError, match=words):
        Dryden(*arguments)


def test_normals_of_the_wrong_shape_are_refused():
    with pytest.raises(InputError, match="time, 8"):
        Dryden("light", 3000, 185, SPAN).sample(np.zeros((4, 6)), 0.1)
