#include "adaptive.h"

#include "least_changes.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

/* Reset what is too short or has changed its sign (17). */
static void make_plausible(const Adaptive *adaptive, double phi[], const double initial[])
{
    const LinearisedPrediction *prediction = adaptive->prediction;
    const size_t inputs = own_inputs(prediction), of_outputs = own_outputs(prediction) * prediction->output_length;
    for (size_t j = 0; j < inputs; ++j) {
        const double direct = initial[of_outputs + j], now = phi[of_outputs + j];
        if (direct == 0.0) continue;
        double squared = 0.0;
        for (size_t lag = 0; lag < prediction->input_length; ++lag)
            squared += phi[of_outputs + lag * inputs + j] * phi[of_outputs + lag * inputs + j];
        const bool right_sign = now * direct > 0.0 || !adaptive->assume_sign;
        const bool long_enough = fabs(now) >= adaptive->epsilon || squared >= adaptive->epsilon * adaptive->epsilon;
        if (right_sign && long_enough) continue;
        const double sign = adaptive->assume_sign ? 1.0 : copysign(1.0, now * direct);
        for (size_t lag = 0; lag < prediction->input_length; ++lag)
            phi[of_outputs + lag * inputs + j] = sign * initial[of_outputs + lag * inputs + j];
        memcpy(phi, initial, of_outputs * sizeof(double));
    }
}

/* The part of H that explains an output. */
static void explain(const Adaptive *adaptive, const AdaptiveMemory *held, size_t output)
{
    const LinearisedPrediction *prediction = adaptive->prediction;
    const size_t p = prediction->p, m = prediction->m, first = prediction->diagonal ? output : 0;
    const double *dy = held->changes, *du = dy + p * prediction->output_length;
    double *h = held->h;
    for (size_t lag = 0; lag < prediction->output_length; ++lag)
        for (size_t i = 0; i < own_outputs(prediction); ++i) *h++ = dy[lag * p + first + i];
    for (size_t lag = 0; lag < prediction->input_length; ++lag)
        for (size_t j = 0; j < own_inputs(prediction); ++j) *h++ = du[lag * m + first + j];
}

/* Learn from the outputs of a new sample, if there is one before it (16)-(17). */
static void observe(const Adaptive *adaptive, const AdaptiveMemory *held, const double y[])
{
    const size_t p = adaptive->prediction->p, terms = own_changes(adaptive->prediction);
    const size_t output_length = adaptive->prediction->output_length;
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
        if (output_length > 0) prepend_sample(held->changes, output_length, p, held->y);
    }
    memcpy(held->y, y, p * sizeof(double));
    *held->begun = 1.0;
}

/* Forget the signals, not the estimates. */
static void forget(const Adaptive *adaptive, const AdaptiveMemory *held)
{
    const LinearisedPrediction *prediction = adaptive->prediction;
    const size_t changes = prediction->p * prediction->output_length + prediction->m * prediction->input_length;
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
    const size_t terms = own_changes(adaptive->prediction), n = adaptive->forecast_order;
    const size_t horizon = adaptive->prediction->horizon;
    for (size_t i = 0; i < adaptive->prediction->p; ++i) {
        double *ahead = held->prediction.ahead + i * horizon * terms;
        memcpy(ahead, held->gradients + i * terms, terms * sizeof(double));
        if (n == 0) continue;
        for (size_t t = i * terms; t < (i + 1) * terms; ++t)
            adapt(adaptive, held->theta + t * n, held->past + t * (n + 1), held->gradients[t]);
        for (size_t k = 1; k < horizon; ++k) {
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

void adaptive_step(const Adaptive *adaptive, const AdaptiveMemory *held, const Sample *sample, double u[], Told *told)
{
    const LinearisedPrediction *prediction = adaptive->prediction;
    const size_t p = prediction->p, m = prediction->m, n = prediction->control_horizon * m;
    double *plan = held->prediction.plan;
    if (!all_finite(sample->y, p)) {
        forget(adaptive, held);
        memcpy(u, held->u, m * sizeof(double));
        told->status |= STATUS_HELD;
        return;
    }
    observe(adaptive, held, sample->y);
    forecast(adaptive, held);
    if (sample->applied != NULL) {
        take_inputs(prediction, held->changes, held->u, sample->applied);
        memcpy(u, sample->applied, m * sizeof(double));
        return;
    }
    predict_outputs(prediction, &held->prediction, held->changes, NULL);
    miss_references(prediction, &held->prediction, sample->reference, sample->y);
    least_changes(prediction, &held->prediction, adaptive->ridge); /* (20) */
    for (size_t i = 0; i < n; ++i) plan[i] *= adaptive->step_factor;
    limit_changes(adaptive->limits, &held->limits, held->u, plan, held->prediction.hessian, u, told);
    take_inputs(prediction, held->changes, held->u, u);
}
