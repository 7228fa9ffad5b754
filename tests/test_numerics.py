import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import logsumexp, ndtri

from mcmc1d import checks, numerics, special

DTYPES = (np.float32, np.float64)


@pytest.fixture(autouse=True, params=DTYPES, ids=["float32", "float64"])
def dtype(request):
    with jax.enable_x64(request.param == np.float64):
        yield request.param


def largest_under_one(dtype):
    return np.nextafter(dtype(1), dtype(0))


def unit_points(dtype, count=2000):
    """Random numbers of [0, 1), its edges, and numbers close to them."""
    eps = np.finfo(dtype).eps
    edges = [0, np.finfo(dtype).tiny, 1e-20, eps, 1e-3, 0.25, 0.5 - eps, 0.5, 0.5 + eps, 1 - eps, 1 - eps / 2]
    return np.concatenate([np.array(edges, dtype), np.random.default_rng(0).random(count).astype(dtype)])


# --- the unit interval ---


def test_wrap_never_leaves_the_unit_interval_and_moves_by_whole_numbers(dtype):
    tiny = np.finfo(dtype).tiny
    edges = [-tiny, -1e-30, -1e-10, -np.finfo(dtype).eps / 4, -0.0, 0, 1, -1, 2.5, -2.5, 1 - 1e-9, 1 + 1e-9]
    x = np.concatenate([np.array(edges, dtype), np.random.default_rng(0).uniform(-3, 3, 5000).astype(dtype)])
    wrapped = np.asarray(numerics.wrap(jnp.asarray(x)))
    assert wrapped.dtype == dtype
    assert ((wrapped >= 0) & (wrapped < 1)).all()
    shift = np.asarray(x, np.longdouble) - wrapped
    assert (np.abs(shift - np.round(shift)) <= np.finfo(dtype).eps / 2).all()


def test_below_one_changes_nothing_but_what_rounding_brought_to_one(dtype):
    u = unit_points(dtype)
    np.testing.assert_array_equal(numerics.below_one(jnp.asarray(u)), u)
    assert numerics.below_one(jnp.ones((), dtype)) == largest_under_one(dtype)


def test_a_limit_is_transparent_to_autodiff(dtype):
    x = jnp.array([-0.5, 0, 0.5, 1, 1.5], dtype)
    np.testing.assert_array_equal(numerics.limit(x, 0, 1), [0, 0, 0.5, 1, 1])
    np.testing.assert_array_equal(jax.vmap(jax.grad(lambda x: numerics.limit(3 * x, 0, 1)))(x), np.full(5, 3))


@pytest.mark.parametrize("bad", [1.0, -1e-9, np.nan, np.inf])
def test_in_unit_cube_needs_every_coordinate_inside(dtype, bad):
    inside = jnp.array([0, 0.5, largest_under_one(dtype)], dtype)
    assert numerics.in_unit_cube(inside)
    assert not numerics.in_unit_cube(inside.at[1].set(bad))


# --- choosing an interval and the place inside it ---

PARTITIONS = {
    "few": [0, 0, 0.3, 0.3, 0.3125, 1, 1],  # intervals of zero width at both ends and inside
    "some": np.repeat(np.linspace(0, 1, 21), 2)[1:-1].tolist(),  # more than are told apart by comparison
    "many": np.unique(np.r_[0, np.random.default_rng(1).random(100), 1]).tolist(),
}


@pytest.mark.parametrize("ends", PARTITIONS.values(), ids=PARTITIONS.keys())
def test_choose_finds_the_interval_and_unchoose_undoes_it(dtype, ends):
    ends = np.array(ends, dtype)
    values = np.concatenate([unit_points(dtype), ends[ends < 1], np.nextafter(ends[ends > 0], dtype(0))])
    k, place = jax.vmap(lambda v: numerics.choose(jnp.asarray(ends), v))(jnp.asarray(values))
    k, place = np.asarray(k), np.asarray(place)
    assert (np.diff(ends)[k] > 0).all(), "an interval of zero width was selected"
    assert ((ends[k] <= values) & (values < ends[k + 1])).all()
    assert ((place >= 0) & (place < 1)).all()
    back = jax.vmap(lambda k, p: numerics.unchoose(jnp.asarray(ends), k, p))(jnp.asarray(k), jnp.asarray(place))
    np.testing.assert_allclose(back, values, rtol=0, atol=2 * np.finfo(dtype).eps)
    assert (np.asarray(back) < 1).all()


@pytest.mark.parametrize("ends", PARTITIONS.values(), ids=PARTITIONS.keys())
def test_choose_undoes_unchoose(dtype, ends):
    ends = np.array(ends, dtype)
    wide = np.flatnonzero(np.diff(ends) > 1e-4)
    rng = np.random.default_rng(2)
    k, place = rng.choice(wide, 1000), rng.uniform(0.01, 0.99, 1000).astype(dtype)

    def there_and_back(k, place):
        return numerics.choose(jnp.asarray(ends), numerics.unchoose(jnp.asarray(ends), k, place))

    k_back, place_back = jax.vmap(there_and_back)(jnp.asarray(k, jnp.int32), jnp.asarray(place))
    np.testing.assert_array_equal(k_back, k)
    # The place is known to the rounding of the number, in units of the interval's width.
    assert (np.abs(place_back - place) * np.diff(ends)[k] <= 2 * np.finfo(dtype).eps).all()


def test_cumulative_is_in_proportion_and_ends_at_exactly_one(dtype):
    ends = numerics.cumulative([jnp.asarray(s, dtype) for s in (1, 0, 2, 0.3, 0.7)])
    np.testing.assert_allclose(ends, [0, 0.25, 0.25, 0.75, 0.825, 1], rtol=2 * np.finfo(dtype).eps)
    assert ends[0] == 0
    assert ends[-1] == 1


@pytest.mark.parametrize("count", [3, 40])
def test_entry_and_width_read_the_table(dtype, count):
    table = np.cumsum(np.arange(count)).astype(dtype)
    for k in (0, 1, count - 2):
        assert numerics.entry(table, jnp.asarray(k)) == table[k]
        assert numerics.width(table, jnp.asarray(k)) == table[k + 1] - table[k]


# --- elementary functions ---

# float64: Cephes' rational approximations, a few ulps. float32: the fit and its rounding, 3e-7.
QUANTILE_TOLERANCE = {np.float32: 4e-7, np.float64: 2e-15}


def test_normal_quantile_is_scipys(dtype):
    w = unit_points(dtype, 20_000)
    w = w[w >= np.finfo(dtype).eps]  # the smallest that the generator yields
    expected = ndtri(w.astype(np.float64))
    error = np.abs(np.asarray(special.normal_quantile(jnp.asarray(w)), np.float64) - expected)
    assert (error <= QUANTILE_TOLERANCE[dtype] * np.maximum(np.abs(expected), 1)).all()


def test_normal_quantile_is_odd_to_the_last_bit_and_infinite_at_the_ends(dtype):
    bits = np.finfo(dtype).nmant
    whole = np.random.default_rng(3).integers(1, 2**bits, 5000)
    w = np.ldexp(np.concatenate([whole, [1, 2, 3, 2**bits - 1]]).astype(dtype), -bits)  # 1 - w is exact
    forth, back = (special.normal_quantile(jnp.asarray(v)) for v in (w, 1 - w))
    np.testing.assert_array_equal(forth, -back)
    np.testing.assert_array_equal(special.normal_quantile(jnp.array([0, 0.5, 1], dtype)), [-np.inf, 0, np.inf])


def test_the_slopes_of_the_normal_quantile_are_one_over_the_density(dtype):
    w = np.array([0.01, 0.3, 0.5, 0.9], dtype)
    z = ndtri(w.astype(np.float64))
    slope = np.sqrt(2 * np.pi) * np.exp(z * z / 2)
    first, second = jax.grad(special.normal_quantile), jax.grad(jax.grad(special.normal_quantile))
    tight = 20 * np.finfo(dtype).eps
    np.testing.assert_allclose(jax.vmap(first)(jnp.asarray(w)), slope, rtol=tight)
    np.testing.assert_allclose(jax.vmap(second)(jnp.asarray(w)), z * slope**2, rtol=tight, atol=tight)
    assert np.isposinf(jax.vmap(first)(jnp.asarray([0, 1], dtype))).all()


def test_outside_of_the_unit_interval_there_is_no_quantile(dtype):
    outside = jnp.asarray([-0.1, 1.1, 1 + np.finfo(dtype).eps, 2, -5, np.nan], dtype)
    assert np.isnan(special.normal_quantile(outside)).all()


SINE_TOLERANCE = {np.float32: 2.4e-7, np.float64: 2.3e-16}


@pytest.mark.parametrize(("function", "quarter"), [(special.sin_turns, 0), (special.cos_turns, 0.25)])
def test_sines_of_turns(dtype, function, quarter):
    turns = np.random.default_rng(4).uniform(-1.5, 1.5, 20_000).astype(dtype)
    turns = np.concatenate([turns, turns[:1000] + dtype(1000), unit_points(dtype)])
    reduced = np.asarray(turns, np.longdouble) + quarter
    reduced -= np.round(reduced)
    # np.pi and the rest of it: 2 pi to the precision of a long double.
    expected = np.sin(2 * (np.longdouble(np.pi) + np.longdouble(1.2246467991473532e-16)) * reduced)
    error = np.abs(np.asarray(function(jnp.asarray(turns)), np.longdouble) - expected)
    assert error.max() <= SINE_TOLERANCE[dtype]


def test_sines_of_quarter_turns_are_exact(dtype):
    quarters = jnp.asarray(np.arange(-8, 9) / 4, dtype)
    expected = np.tile([0, 1, 0, -1], 5)[:17]
    np.testing.assert_allclose(special.sin_turns(quarters), expected, atol=np.finfo(dtype).eps)
    np.testing.assert_array_equal(np.asarray(special.sin_turns(quarters))[::2], 0)


@pytest.mark.parametrize(
    "terms",
    [[0.0], [-np.inf, -np.inf], [-np.inf, 0.5, -2], [1000, 999.5], [-1000, -1001, -np.inf], [3, 3, 3, 3]],
)
def test_log_sum(dtype, terms):
    value = special.log_sum([jnp.asarray(t, dtype) for t in terms])
    np.testing.assert_allclose(value, logsumexp(terms), rtol=4 * np.finfo(dtype).eps)
    assert value.dtype == dtype


@pytest.mark.parametrize("terms", [(0.3, 0.3), (0.3, -2.0), (-np.inf, 1.0), (-np.inf, -np.inf), (2.0, 2.0, -1.0)])
def test_the_slopes_of_a_log_sum_are_the_shares(dtype, terms):
    """Of two that are equal each has a half; one of them had all."""
    slopes = jax.grad(special.log_sum)([jnp.asarray(t, dtype) for t in terms])
    shares = np.exp(np.array(terms) - logsumexp(terms)) if np.isfinite(max(terms)) else np.zeros(len(terms))
    np.testing.assert_allclose(slopes, shares, atol=4 * np.finfo(dtype).eps)


def test_a_log_sum_of_what_is_undefined_is_undefined():
    for terms in ((np.nan, 0.0), (0.0, np.nan), (np.nan, -np.inf), (np.nan, np.inf)):
        assert np.isnan(special.log_sum([jnp.asarray(t) for t in terms]))
    assert np.isnan(jax.grad(lambda a: special.log_sum([a, jnp.asarray(0.0)]))(np.nan))
    assert np.isposinf(special.log_sum([jnp.asarray(np.inf), jnp.asarray(-np.inf)]))


def test_a_log_sum_bends_as_it_should(dtype):
    bend = jax.hessian(lambda t: special.log_sum([t[0], t[1]]))(jnp.asarray([0.7, 0.7], dtype))
    np.testing.assert_allclose(bend, [[0.25, -0.25], [-0.25, 0.25]], atol=1e-6)


# --- one cell of a piecewise linear density ---


@pytest.mark.parametrize(("left", "right"), [(0, 1), (0, 7e3), (1, 0), (3e-5, 0), (1, 1), (1, 3), (5, 0.01)])
def test_linear_quantile_is_the_inverse_of_the_distribution_function(dtype, left, right):
    place = unit_points(dtype)
    quantile = jax.vmap(lambda p: numerics.linear_quantile(jnp.asarray(left, dtype), jnp.asarray(right, dtype), p))
    cdf = jax.vmap(lambda t: numerics.linear_cdf(jnp.asarray(left, dtype), jnp.asarray(right, dtype), t))
    t = quantile(jnp.asarray(place))
    eps = np.finfo(dtype).eps
    np.testing.assert_allclose(cdf(t), place, rtol=0, atol=4 * eps)
    if left == 0:
        np.testing.assert_allclose(t, np.sqrt(place), rtol=4 * eps)
    if right == 0:
        expected = -np.expm1(np.log1p(-place.astype(np.float64)) / 2)
        np.testing.assert_allclose(t, expected, rtol=4 * eps, atol=np.finfo(dtype).tiny)  # XLA flushes subnormals
    if left == right:
        np.testing.assert_allclose(t, place, rtol=4 * eps)
    assert ((np.asarray(t) >= 0) & (np.asarray(t) < 1)).all()


# --- parameters and checks ---


def test_cast_changes_floats_alone(dtype):
    before = {"a": np.zeros(2), "b": np.arange(2, dtype=np.int32), "c": 0.5, "d": None}
    after = numerics.cast(before, dtype)
    assert after["a"].dtype == dtype
    assert after["b"].dtype == np.int32
    assert after["c"] == 0.5


@pytest.mark.parametrize("bad", [0, -1, np.nan, np.inf, [1, 0]])
def test_require_positive_names_the_parameter(bad):
    with pytest.raises(ValueError, match="object: sigma must be positive and finite"):
        checks.require_positive(object(), sigma=bad)
