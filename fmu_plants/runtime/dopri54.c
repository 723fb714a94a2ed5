/* Dormand-Prince 5(4) with local extrapolation.
 *
 * J. R. Dormand, P. J. Prince: A family of embedded Runge-Kutta formulae. J. Comput. Appl. Math. 6 (1980) 19-26.
 * Step size control and initial step: E. Hairer, S. P. Norsett, G. Wanner: Solving Ordinary Differential
 * Equations I, 2nd ed. (1993), section II.4; the tableau is table 5.2 of section II.5 there. */
#include "dopri54.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define LAST (DOPRI54_STAGES - 1)

static const double NODES[DOPRI54_STAGES] = {0.0, 1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0, 1.0};

/* The last row is also the fifth-order result, so that the last slope is the first one of the next step. */
static const double WEIGHTS[DOPRI54_STAGES][LAST] = {
    {0.0},
    {1.0 / 5.0},
    {3.0 / 40.0, 9.0 / 40.0},
    {44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0},
    {19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0},
    {9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0},
    {35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0}};

/* Fifth-order weights minus fourth-order weights. */
static const double ERROR_WEIGHTS[DOPRI54_STAGES] = {71.0 / 57600.0,       0.0,          -71.0 / 16695.0, 71.0 / 1920.0,
                                                     -17253.0 / 339200.0,  22.0 / 525.0, -1.0 / 40.0};

static const double ERROR_EXPONENT = 1.0 / 5.0;
static const double SAFETY = 0.9;
static const double SMALLEST_FACTOR = 0.2;
static const double LARGEST_FACTOR = 10.0;
static const long MAX_STEPS = 10000000; /* a call that never returns is worse than one that fails */

static bool all_finite(const double values[], size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(values[i])) return false;
    }
    return true;
}

static double *stage(const Dopri54 *method, size_t index)
{
    return method->stages + index * method->n;
}

/* Root mean square of `values` in units of the tolerance at the states x and (if not NULL) x_new. */
static double scaled_norm(const Dopri54 *method, const double values[], const double x[], const double x_new[])
{
    double sum = 0.0;
    for (size_t i = 0; i < method->n; ++i) {
        const double size = x_new ? fmax(fabs(x[i]), fabs(x_new[i])) : fabs(x[i]);
        const double ratio = values[i] / (method->absolute_tolerance[i] + method->relative_tolerance * size);
        sum += ratio * ratio;
    }
    return sqrt(sum / (double)method->n);
}

/* A first guess from the sizes of state and slope; the error control corrects it (Hairer et al., II.4, a to b). */
static double initial_step(const Dopri54 *method, const double x[], double span)
{
    const double state = scaled_norm(method, x, x, NULL);
    const double slope = scaled_norm(method, stage(method, 0), x, NULL);
    const double guess = (state < 1e-5 || slope < 1e-5) ? 1e-6 : 0.01 * state / slope;
    return fmin(guess, span);
}

/* Compute slopes 2 to 7 and the new state (left in `trial`); false if a slope is not finite. */
static bool attempt(const Dopri54 *method, RightHandSide f, void *context, double time, double step, const double x[])
{
    const size_t n = method->n;
    for (size_t s = 1; s < DOPRI54_STAGES; ++s) {
        for (size_t i = 0; i < n; ++i) {
            double slope = 0.0;
            for (size_t j = 0; j < s; ++j) slope += WEIGHTS[s][j] * method->stages[j * n + i];
            method->trial[i] = x[i] + step * slope;
        }
        f(time + NODES[s] * step, method->trial, context, stage(method, s));
        if (!all_finite(stage(method, s), n)) return false;
    }
    return true;
}

/* Local error of the attempt in units of the tolerance. Its place is that of slope 2, which has no part in it. */
static double local_error(const Dopri54 *method, double step, const double x[])
{
    const size_t n = method->n;
    double *error = stage(method, 1);
    for (size_t i = 0; i < n; ++i) {
        double slope = 0.0;
        for (size_t s = 0; s < DOPRI54_STAGES; ++s) {
            if (ERROR_WEIGHTS[s] != 0.0) slope += ERROR_WEIGHTS[s] * method->stages[s * n + i];
        }
        error[i] = step * slope;
    }
    return scaled_norm(method, error, x, method->trial);
}

static double step_factor(double error)
{
    const double factor = SAFETY * pow(error, -ERROR_EXPONENT); /* an error of 0 gives infinity, limited below */
    return fmin(LARGEST_FACTOR, fmax(SMALLEST_FACTOR, factor));
}

/* The proposed step, or what ends the span exactly; the last two steps share the rest, so that none is a sliver. */
static double fitted_step(double proposal, double rest)
{
    if (proposal >= rest) return rest;
    return 2.0 * proposal > rest ? 0.5 * rest : proposal;
}

Dopri54Result dopri54_integrate(const Dopri54 *method, RightHandSide f, void *context, double start, double span,
                                double x[], double *step, double *elapsed)
{
    const size_t n = method->n;
    double proposal = *step;
    bool rejected = false;
    bool finite = true;

    *elapsed = 0.0;
    if (n == 0) {
        *elapsed = span;
        return DOPRI54_DONE;
    }
    f(start, x, context, stage(method, 0));
    if (!all_finite(stage(method, 0), n)) return DOPRI54_NOT_FINITE;
    if (!(proposal > 0.0)) proposal = initial_step(method, x, span);

    for (long count = 0; count < MAX_STEPS; ++count) {
        const double rest = span - *elapsed;
        const double h = fitted_step(proposal, rest);
        if (*elapsed + h == *elapsed) return finite ? DOPRI54_STEP_VANISHED : DOPRI54_NOT_FINITE;

        finite = attempt(method, f, context, start + *elapsed, h, x);
        const double error = finite ? local_error(method, h, x) : INFINITY;
        if (!(error <= 1.0)) {
            proposal = h * (finite ? step_factor(error) : SMALLEST_FACTOR);
            rejected = true;
            continue;
        }

        memcpy(x, method->trial, n * sizeof(double));
        memcpy(stage(method, 0), stage(method, LAST), n * sizeof(double));
        const double grown = h * (rejected ? fmin(1.0, step_factor(error)) : step_factor(error));
        /* A step cut short by the end of the span says nothing against the proposal it was cut from. */
        proposal = h < proposal ? fmax(proposal, grown) : grown;
        rejected = false;
        if (h == rest) {
            *elapsed = span;
            *step = proposal;
            return DOPRI54_DONE;
        }
        *elapsed += h;
    }
    return DOPRI54_TOO_MANY_STEPS;
}
