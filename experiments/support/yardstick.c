// One step of the 1D multiplexed chain, written by hand: what this processor can do (see bench.py for the step).
// GCC's vector extension, one register wide: AVX-512, or AVX2, or what there is. W such groups are interleaved.
//   cc -O3 -march=native -ffast-math yardstick.c -o yardstick -lm && ./yardstick GROUPS STEPS SEED
#if defined(__AVX512F__) || defined(__AVX2__)
#include <immintrin.h>
#endif
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef __AVX512F__
enum { LANES = 16 };
#else
enum { LANES = 8 };
#endif
enum { W = 2, BINS = 100, SUBHISTOGRAMS = 4 };
typedef float real __attribute__((vector_size(4 * LANES)));
typedef int32_t mask __attribute__((vector_size(4 * LANES)));
typedef uint32_t word __attribute__((vector_size(4 * LANES)));
#define EACH for (int g = 0; g < W; g++)
#define ALWAYS static inline __attribute__((always_inline))

ALWAYS real choose(mask m, real a, real b) { return (real)((m & (mask)a) | (~m & (mask)b)); }
ALWAYS real least(real a, real b) { return choose(a < b, a, b); }
ALWAYS real most(real a, real b) { return choose(a > b, a, b); }
#ifdef __AVX512F__  // three things that the compiler does not find by itself
ALWAYS real whole(real a) { return (real)_mm512_roundscale_ps((__m512)a, 1); }
ALWAYS real root(real a) { return (real)_mm512_sqrt_ps((__m512)a); }
ALWAYS real over(real a, real b) {  // a / b by the 14-bit reciprocal and one Newton step
  real r = (real)_mm512_rcp14_ps((__m512)b);
  return a * (r * (2 - b * r));
}
#elif defined(__AVX2__)
ALWAYS real whole(real a) { return (real)_mm256_floor_ps((__m256)a); }
ALWAYS real root(real a) { return (real)_mm256_sqrt_ps((__m256)a); }
ALWAYS real over(real a, real b) {  // by the 12-bit reciprocal
  real r = (real)_mm256_rcp_ps((__m256)b);
  return a * (r * (2 - b * r));
}
#else
ALWAYS real whole(real a) {  // floor, of numbers far smaller than 2^31
  real t = __builtin_convertvector(__builtin_convertvector(a, mask), real);
  return t - choose(t > a, (real){} + 1, (real){});
}
ALWAYS real root(real a) {
  real r;
  for (int i = 0; i < LANES; i++) r[i] = sqrtf(a[i]);
  return r;
}
ALWAYS real over(real a, real b) { return a / b; }
#endif

// xoshiro128++ (Blackman and Vigna), a generator in each lane.
typedef struct { word s[4]; } generator;
ALWAYS word turn(word x, int k) { return (x << k) | (x >> (32 - k)); }
ALWAYS real uniform(generator *r) {
  word *s = r->s, out = turn(s[0] + s[3], 7) + s[0], t = s[1] << 9;
  s[2] ^= s[0]; s[3] ^= s[1]; s[1] ^= s[2]; s[0] ^= s[3]; s[2] ^= t; s[3] = turn(s[3], 11);
  return __builtin_convertvector((mask)(out >> 8), real) * 0x1p-24f;
}

// sin and cos of 2 pi x for x in [0, 1]: least-maximum polynomials in (x - 1/2)^2.
ALWAYS void sincos_turns(real x, real *sine, real *cosine) {
  real y = x - .5f, z = y * y;
  *sine = -y * (.25f - z) * (25.13273f + z * (-64.83468f + z * (67.04390f + z * (-38.12320f + z * 12.23330f))));
  *cosine = -(.9999993f + z * (-19.73898f + z * (64.92866f + z * (-85.27162f + z * (58.79049f - z * 21.07111f)))));
}
// Natural logarithm on (0, 1]: exponent and mantissa apart, and a polynomial in the mantissa less one.
ALWAYS real logarithm(real x) {
  mask bits = (mask)x;
  real e = __builtin_convertvector((bits >> 23) - 127, real);
  real m = (real)((bits & 0x7fffff) | 0x3f800000);
  mask high = m > 1.41421356f;
  m = choose(high, m * .5f, m) - 1;
  e = e + choose(high, (real){} + 1, (real){});
  real z = m * m, p = 7.0376836e-2f * m - 1.1514610e-1f;
  p = p * m + 1.1676999e-1f; p = p * m - 1.2420141e-1f; p = p * m + 1.4249323e-1f; p = p * m - 1.6668058e-1f;
  p = p * m + 2.0000715e-1f; p = p * m - 2.4999994e-1f; p = p * m + 3.3333331e-1f;
  return m + z * (m * p - .5f) + e * .69314718f;
}

ALWAYS real sample(real u, mask t) {  // tent, step, and the smooth density by three Newton steps
  mask low = u < .5f;
  real q = root(.5f * choose(low, u, 1 - u)), tent = choose(low, q, 1 - q);
  real step = choose(u < .1f, u * 2.5f,
              choose(u < .5f, .25f + (u - .1f) * .625f,
              choose(u < .65f, .5f + (u - .5f) * 1.6666667f, .75f + (u - .65f) * .71428571f)));
  real x = .94076407f * root(u + 1e-4f) - .0493469f;
  for (int k = 0; k < 3; k++) {
    real s, c;
    sincos_turns(x, &s, &c);
    x = x - over(x * (.6f + .4f * x) - s * .07957747f - u, .6f + .8f * x - .5f * c);
    x = least(most(x, (real){}), (real){} + 1);
  }
  return choose(t == 0, tent, choose(t == 1, step, x));
}
ALWAYS real density(real x) {  // f / (p_0 + p_1 + p_2)
  real s, c;
  sincos_turns(x, &s, &c);
  real tent = 4 * least(x, 1 - x), step = choose(x < .25f, (real){} + .4f,
    choose(x < .5f, (real){} + 1.6f, choose(x < .75f, (real){} + .6f, (real){} + 1.4f)));
  return over(1 + 1.8f * s * c, tent + step + (.6f + .8f * x - .5f * c));
}

static float histogram[SUBHISTOGRAMS][128];  // several, so that one add need not wait for the last
ALWAYS void deposit(real x, real weight) {
  mask cell = __builtin_convertvector(x * (float)BINS, mask);
  for (int i = 0; i < LANES; i++) histogram[i % SUBHISTOGRAMS][cell[i] < BINS ? cell[i] : BINS - 1] += weight[i];
}

int main(int argc, char **argv) {
  if (argc != 4) { fprintf(stderr, "usage: %s GROUPS STEPS SEED\n", argv[0]); return 2; }
  long groups = atol(argv[1]), steps = atol(argv[2]);
  uint64_t z = (uint64_t)atol(argv[3]) * 1000003u;
  double total[BINS] = {0}, accepted = 0;
  struct timespec t0, t1;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t0);
  for (long block = 0; block < groups; block++) {
    generator r[W]; real u[W], x[W], c[W], sum[W]; mask t[W];
    EACH {
      for (int j = 0; j < 4; j++) for (int i = 0; i < LANES; i++) {  // splitmix64 (Steele, Lea and Flood)
        uint64_t q = (z += 0x9e3779b97f4a7c15u);
        q = (q ^ (q >> 30)) * 0xbf58476d1ce4e5b9u; q = (q ^ (q >> 27)) * 0x94d049bb133111ebu;
        r[g].s[j][i] = (uint32_t)(q >> 32);
      }
      u[g] = uniform(&r[g]); t[g] = __builtin_convertvector(uniform(&r[g]) * 3, mask);
      x[g] = sample(u[g], t[g]); c[g] = density(x[g]); sum[g] = (real){};
    }
    for (long k = 0; k < steps; k += 2) {
      real normal[2][W];
      EACH {  // Box and Muller: two normals of standard deviation 0.05
        real s, o, radius = root(-.005f * logarithm(1 - uniform(&r[g])));
        sincos_turns(uniform(&r[g]), &s, &o);
        normal[0][g] = radius * o; normal[1][g] = radius * s;
      }
      for (int half = 0; half < 2; half++) EACH {
        real v = u[g] + normal[half][g];
        v = v - whole(v);
        real change = uniform(&r[g]);
        mask other = __builtin_convertvector(change * 10, mask);
        other = ((other > 2) & 2) | (~(other > 2) & other);
        mask j = ((mask)(change < .3f) & other) | (~(mask)(change < .3f) & t[g]);
        real y = sample(v, j), d = density(y), a = least(over(d, c[g]), (real){} + 1);
        deposit(x[g], 1 - a); deposit(y, a);
        mask yes = uniform(&r[g]) < a;
        u[g] = choose(yes, v, u[g]); x[g] = choose(yes, y, x[g]); c[g] = choose(yes, d, c[g]);
        t[g] = (yes & j) | (~yes & t[g]);
        sum[g] = sum[g] + a;
      }
    }
    EACH for (int i = 0; i < LANES; i++) accepted += sum[g][i];
    for (int s = 0; s < SUBHISTOGRAMS; s++) for (int b = 0; b < BINS; b++) total[b] += histogram[s][b];
    memset(histogram, 0, sizeof histogram);  // drained into doubles: a float stops counting at 2^24
  }
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t1);
  double n = (double)groups * W * LANES * steps, variation = 0;
  for (int b = 0; b < BINS; b++) {
    double exact = (1 + .9 * (cos(4 * M_PI * b / BINS) - cos(4 * M_PI * (b + 1) / BINS)) / (4 * M_PI) * BINS) / BINS;
    variation += fabs(total[b] / n - exact) / 2;
  }
  double seconds = (double)(t1.tv_sec - t0.tv_sec) + 1e-9 * (double)(t1.tv_nsec - t0.tv_nsec);
  printf("%.6e %.6f %.6f\n", n / seconds, accepted / n, variation);
}
