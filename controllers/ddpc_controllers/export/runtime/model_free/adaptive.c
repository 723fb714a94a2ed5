#include "adaptive.h"

#include "vectors.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define SWEEPS 60

/* How many outputs and inputs one output's change is explained by. */
static size_t own_outputs(const Adaptive *adaptive) { return adaptive->diagonal ? 1 : adaptive->p; }
static size_t own_inputs(const Adaptive *adaptive) { return adaptive->diagonal ? 1 : adaptive->m; }

static size_t width(const Adaptive *adaptive)
{
    return own_outputs(adaptive) * adaptive->output_length + own_inputs(adaptive) * adaptive->input_length;
}

/* Reset what is too short or has changed its sign (17). */
static void make_plausible(const Adaptive *adaptive, double phi[], const double initial[])
{
    const size_t inputs = own_inputs(adaptive), of_outputs = own_outputs(adaptive) * adaptive->output_length;
    for (size_t j = 0; j < inputs; ++j) {
        const double direct = initial[of_outputs + j], now = phi[of_outputs + j];
        if (direct == 0.0) continue;
        double squared = 0.0;
        for (size_t lag = 0; lag < adaptive->input_length; ++lag)
            squared += phi[of_outputs + lag * inputs + j] * phi[of_outputs + lag * inputs + j];
        const bool right_sign = now * direct > 0.0 || !adaptive->assume_sign;
        const bool long_enough = fabs(now) >= adaptive->epsilon || squared >= adaptive->epsilon * adaptive->epsilon;
        if (right_sign && long_enough) continue;
        const double sign = adaptive->assume_sign ? 1.0 : copysign(1.0, now * direct);
        for (size_t lag = 0; lag < adaptive->input_length; ++lag)
            phi[of_outputs + lag * inputs + j] = sign * initial[of_outputs + lag * inputs + j];
        memcpy(phi, initial, of_outputs * sizeof(double));
    }
}

/* The part of H that explains an output. */
static void explain(const Adaptive *adaptive, const AdaptiveMemory *held, size_t output)
{
    const double *dy = held->changes, *du = dy + adaptive->p * adaptive->output_length;
    const size_t first_output = adaptive->diagonal ? output : 0, first_input = first_output;
    double *h = held->h;
    for (size_t lag = 0; lag < adaptive->output_length; ++lag)
        for (size_t i = 0; i < own_outputs(adaptive); ++i) *h++ = dy[lag * adaptive->p + first_output + i];
    for (size_t lag = 0; lag < adaptive->input_length; ++lag)
        for (size_t j = 0; j < own_inputs(adaptive); ++j) *h++ = du[lag * adaptive->m + first_input + j];
}

/* Learn from the outputs of a new sample, if there is one before it (16)-(17). */
static void observe(const Adaptive *adaptive, const AdaptiveMemory *held, const double y[])
{
    const size_t p = adaptive->p, terms = width(adaptive);
    if (*held->begun != 0.0) {
        for (size_t i = 0; i < p; ++i) {
            double *phi = held->gradients + i * terms;
            const double *initial = adaptive->initial + i * terms;
            explain(adaptive, held, i);
            const double squared = dot(held->h, held->h, terms), dy = y[i] - held->y[i];
            if (sqrt(squared) > adaptive->epsilon) {
                const double missed = dy - dot(phi, held->h, terms);
                const double step = adaptive->eta / (adaptive->mu + squared) * missed;
                for (size_t t = 0; t < terms; ++t) phi[t] += step * held->h[t];
                make_plausible(adaptive, phi, initial);
            } else if (adaptive->assume_sign) {
                memcpy(phi, initial, terms * sizeof(double));
            }
        }
        for (size_t i = 0; i < p; ++i) held->y[i] = y[i] - held->y[i];
        if (adaptive->output_length > 0) prepend_sample(held->changes, adaptive->output_length, p, held->y);
    }
    memcpy(held->y, y, p * sizeof(double));
    *held->begun = 1.0;
}

/* Forget the signals, not the estimates. */
static void forget(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const size_t changes = adaptive->p * adaptive->output_length + adaptive->m * adaptive->input_length;
    *held->begun = 0.0;
    for (size_t i = 0; i < changes; ++i) held->changes[i] = 0.0;
}

/* Adapt the coefficients of one forecast to the latest estimate (18). */
static void adapt(const Adaptive *adaptive, double theta[], double past[], double phi)
{
    const size_t n = adaptive->forecast_order;
    const double step = (phi - dot(theta, past, n)) / (adaptive->delta + dot(past, past, n));
    for (size_t i = 0; i < n; ++i) theta[i] += step * past[i];
    if (dot(theta, theta, n) >= adaptive->theta_limit * adaptive->theta_limit)
        for (size_t i = 0; i < n; ++i) theta[i] = adaptive->theta_0;
    prepend_sample(past, n + 1, 1, &phi);
}

/* The gradients of the samples to come. */
static void forecast(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const size_t terms = width(adaptive), n = adaptive->forecast_order;
    for (size_t i = 0; i < adaptive->p; ++i) {
        double *ahead = held->ahead + i * adaptive->horizon * terms;
        memcpy(ahead, held->gradients + i * terms, terms * sizeof(double));
        if (n == 0) continue;
        for (size_t t = i * terms; t < (i + 1) * terms; ++t)
            adapt(adaptive, held->theta + t * n, held->past + t * (n + 1), held->gradients[t]);
        for (size_t k = 1; k < adaptive->horizon; ++k) {
            for (size_t t = 0; t < terms; ++t) {
                const double *theta = held->theta + (i * terms + t) * n;
                const double *past = held->past + (i * terms + t) * (n + 1);
                double sum = 0.0;
                for (size_t lag = 0; lag < n; ++lag)
                    sum += theta[lag] * (lag < k ? ahead[(k - 1 - lag) * terms + t] : past[lag - k + 1]);
                ahead[k * terms + t] = sum;
            }
            make_plausible(adaptive, ahead + k * terms, adaptive->initial + i * terms);
        }
    }
}

/* One row of dY = W_known known + W_decided dU + W_coming dY, with the rows before it put in for dY. */
static void predict_change(const Adaptive *adaptive, const AdaptiveMemory *held, size_t k, size_t output)
{
    const size_t p = adaptive->p, m = adaptive->m, n = adaptive->control_horizon * m;
    const size_t first = adaptive->diagonal ? output : 0;
    const double *phi = held->ahead + (output * adaptive->horizon + k) * width(adaptive);
    const double *dy = held->changes, *du = dy + p * adaptive->output_length;
    double *row = held->response + (k * p + output) * (n + 1);
    for (size_t i = 0; i <= n; ++i) row[i] = 0.0;
    for (size_t lag = 0; lag < adaptive->output_length; ++lag) {
        for (size_t i = first; i < first + own_outputs(adaptive); ++i, ++phi) {
            if (lag >= k) {
                row[n] += *phi * dy[(lag - k) * p + i];
                continue;
            }
            const double *coming = held->response + ((k - lag - 1) * p + i) * (n + 1);
            for (size_t c = 0; c <= n; ++c) row[c] += *phi * coming[c];
        }
    }
    for (size_t lag = 0; lag < adaptive->input_length; ++lag) {
        for (size_t j = first; j < first + own_inputs(adaptive); ++j, ++phi) {
            if (lag > k) row[n] += *phi * du[(lag - k - 1) * m + j];
            else if (k - lag < adaptive->control_horizon) row[(k - lag) * m + j] += *phi;
        }
    }
}

/* A and f, as one matrix. */
static void predict(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const size_t p = adaptive->p, columns = adaptive->control_horizon * adaptive->m + 1;
    for (size_t k = 0; k < adaptive->horizon; ++k)
        for (size_t i = 0; i < p; ++i) predict_change(adaptive, held, k, i);
    for (size_t at = p * columns; at < adaptive->horizon * p * columns; ++at)
        held->response[at] += held->response[at - p * columns];
}

/* Make columns a and b of a matrix, so many rows apart from each other, orthogonal by turning them; and turn
 * those of `turned` with them. True: they were so already. */
static bool orthogonalise(double matrix[], size_t rows, double turned[], size_t n, size_t a, size_t b)
{
    double aa = 0.0, bb = 0.0, ab = 0.0;
    for (size_t i = 0; i < rows; ++i) {
        aa += matrix[i * n + a] * matrix[i * n + a];
        bb += matrix[i * n + b] * matrix[i * n + b];
        ab += matrix[i * n + a] * matrix[i * n + b];
    }
    if (!(fabs(ab) > DBL_EPSILON * sqrt(aa * bb))) return true;
    const double zeta = (bb - aa) / (2.0 * ab), t = copysign(1.0, zeta) / (fabs(zeta) + hypot(1.0, zeta));
    const double cosine = 1.0 / hypot(1.0, t), sine = cosine * t;
    for (size_t i = 0; i < rows + n; ++i) {
        double *row = i < rows ? matrix + i * n : turned + (i - rows) * n;
        const double left = row[a], right = row[b];
        row[a] = cosine * left - sine * right;
        row[b] = sine * left + cosine * right;
    }
    return false;
}

/* The shortest of the least-squares solutions of [A; sqrt(lambda) I] dU = [error; 0], by one-sided Jacobi
 * rotations: for a lambda that is lost in the rounding of A'A. */
static void solve_least_squares(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const size_t n = adaptive->control_horizon * adaptive->m, equations = adaptive->horizon * adaptive->p;
    double *stacked = held->tall, *turned = held->factor, largest = 0.0;
    for (size_t i = 0; i < equations; ++i)
        memcpy(stacked + i * n, held->response + i * (n + 1), n * sizeof(double));
    for (size_t i = 0; i < n * n; ++i) {
        turned[i] = i % (n + 1) == 0 ? 1.0 : 0.0;
        stacked[equations * n + i] = turned[i] * sqrt(adaptive->lambda_u);
    }
    bool done = false;
    for (int sweep = 0; sweep < SWEEPS && !done; ++sweep) {
        done = true;
        for (size_t b = 1; b < n; ++b)
            for (size_t a = 0; a < b; ++a) done = orthogonalise(stacked, equations + n, turned, n, a, b) && done;
    }
    for (size_t j = 0; j < n; ++j) {
        double squared = 0.0;
        for (size_t i = 0; i < equations + n; ++i) squared += stacked[i * n + j] * stacked[i * n + j];
        held->slope[j] = sqrt(squared);
        largest = fmax(largest, held->slope[j]);
        held->plan[j] = 0.0;
    }
    for (size_t j = 0; j < n; ++j) {
        const double singular = held->slope[j];
        if (!(singular > DBL_EPSILON * (double)(equations + n) * largest)) continue;
        double projected = 0.0;
        for (size_t i = 0; i < equations; ++i) projected += stacked[i * n + j] / singular * held->error[i];
        for (size_t i = 0; i < n; ++i) held->plan[i] += turned[i * n + j] * (projected / singular);
    }
}

/* The changes that minimise (19), limits aside: (20). */
static void solve_unlimited(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const size_t n = adaptive->control_horizon * adaptive->m, rows = adaptive->horizon * adaptive->p;
    for (size_t i = 0; i < n * n; ++i) held->hessian[i] = i % (n + 1) == 0 ? adaptive->lambda_u : 0.0;
    for (size_t i = 0; i < n; ++i) held->slope[i] = 0.0;
    for (size_t k = 0; k < rows; ++k) {
        const double *row = held->response + k * (n + 1);
        /* A is triangular: no output follows what comes after it. */
        const size_t before = (k / adaptive->p + 1) * adaptive->m;
        for (size_t i = 0; i < n && i < before; ++i) {
            held->slope[i] += row[i] * held->error[k];
            for (size_t j = 0; j <= i; ++j) held->hessian[i * n + j] += row[i] * row[j];
        }
    }
    for (size_t i = 0; i < n; ++i)
        for (size_t j = 0; j < i; ++j) held->hessian[j * n + i] = held->hessian[i * n + j];
    memcpy(held->plan, held->slope, n * sizeof(double));
    if (!all_finite(held->hessian, n * n) || !all_finite(held->slope, n)) {
        held->plan[0] = NAN;
        return;
    }
    if (!factorise(held->hessian, held->factor, n)) {
        solve_least_squares(adaptive, held);
        return;
    }
    for (size_t i = 0; i < n; ++i)
        held->plan[i] = (held->plan[i] - dot(held->factor + i * n, held->plan, i)) / held->factor[i * n + i];
    for (size_t i = n; i-- > 0;) {
        for (size_t j = i + 1; j < n; ++j) held->plan[i] -= held->factor[j * n + i] * held->plan[j];
        held->plan[i] /= held->factor[i * n + i];
    }
}

/* Note how the inputs change, and what they are. */
static void take_inputs(const Adaptive *adaptive, const AdaptiveMemory *held, const double u[])
{
    const size_t m = adaptive->m;
    for (size_t j = 0; j < m; ++j) held->u[j] = u[j] - held->u[j];
    prepend_sample(held->changes + adaptive->p * adaptive->output_length, adaptive->input_length, m, held->u);
    memcpy(held->u, u, m * sizeof(double));
}

void adaptive_step(const Adaptive *adaptive, const AdaptiveMemory *held, const Sample *sample, double u[], Told *told)
{
    const size_t p = adaptive->p, m = adaptive->m, n = adaptive->control_horizon * m;
    if (!all_finite(sample->y, p)) {
        forget(adaptive, held);
        memcpy(u, held->u, m * sizeof(double));
        told->status |= STATUS_HELD;
        return;
    }
    observe(adaptive, held, sample->y);
    forecast(adaptive, held);
    if (sample->applied != NULL) {
        take_inputs(adaptive, held, sample->applied);
        memcpy(u, sample->applied, m * sizeof(double));
        return;
    }
    predict(adaptive, held);
    for (size_t k = 0; k < adaptive->horizon * p; ++k)
        held->error[k] = sample->reference[k] - sample->y[k % p] - held->response[k * (n + 1) + n];
    solve_unlimited(adaptive, held);
    for (size_t i = 0; i < n; ++i) held->plan[i] *= adaptive->step_factor;
    limit_changes(adaptive->limits, &held->limits, held->u, held->plan, held->hessian, u, told);
    take_inputs(adaptive, held, u);
}
