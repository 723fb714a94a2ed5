#include "ipid.h"

#include "vectors.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

static void observe(const IPID *ipid, const IPIDMemory *held, const double y[])
{
    if (*held->begun != 0.0) {
        append_sample(held->window_u, ipid->samples, ipid->p, held->u);
        append_sample(held->window_y, ipid->samples + 1, ipid->p, y);
        return;
    }
    fill_window(held->window_y, ipid->samples + 1, ipid->p, y);
    fill_window(held->window_u, ipid->samples, ipid->p, held->u);
    *held->begun = 1.0;
}

static void estimate(const IPID *ipid, const IPIDMemory *held)
{
    const size_t p = ipid->p, n = ipid->samples;
    for (size_t row = 0; row <= ipid->order; ++row) {
        double *estimates = held->estimates + row * p;
        const double *of_outputs = ipid->of_outputs + row * (n + 1), *of_inputs = ipid->of_inputs + row * n;
        for (size_t i = 0; i < p; ++i) {
            estimates[i] = 0.0;
            for (size_t k = 0; k <= n; ++k) estimates[i] += of_outputs[k] * held->window_y[k * p + i];
        }
        for (size_t j = 0; j < p; ++j) {
            double response = 0.0;
            for (size_t k = 0; k < n; ++k) response += of_inputs[k] * held->window_u[k * p + j];
            for (size_t i = 0; i < p; ++i) estimates[i] -= response * ipid->alpha[i * p + j];
        }
    }
}

/* The output that the model expects at the next sample under the inputs that are held. */
static double ahead(const IPID *ipid, const IPIDMemory *held, size_t output)
{
    const size_t p = ipid->p;
    const double h = ipid->sampling_time;
    const double highest = held->estimates[ipid->order * p + output] + dot(ipid->alpha + output * p, held->u, p);
    if (ipid->order == 1) return held->estimates[output] + h * highest;
    return held->estimates[output] + h * held->estimates[p + output] + h * h / 2.0 * highest;
}

/* The integral with which the last inputs were its own, for the reference of this sample. */
static void take_over(const IPID *ipid, const IPIDMemory *held, const double setpoint[])
{
    const size_t p = ipid->p;
    *held->begun = 1.0;
    if (ipid->ki == 0.0 || !all_finite(setpoint, p)) return;
    estimate(ipid, held);
    for (size_t i = 0; i < p; ++i) {
        const double error = setpoint[i] - held->window_y[ipid->samples * p + i];
        double rest = dot(ipid->alpha + i * p, held->u, p) + held->estimates[ipid->order * p + i] - ipid->kp * error;
        if (ipid->order > 1) rest += ipid->kd * held->estimates[p + i];
        held->integral[i] = rest / ipid->ki;
    }
}

void ipid_step(const IPID *ipid, const IPIDMemory *held, const Sample *sample, double u[], Told *told)
{
    const size_t p = ipid->p;
    if (sample->applied != NULL) {
        if (*held->begun == 0.0) memcpy(held->u, sample->applied, p * sizeof(double));
        observe(ipid, held, sample->y);
        memcpy(held->u, sample->applied, p * sizeof(double));
        memcpy(u, sample->applied, p * sizeof(double));
        *held->begun = -1.0;
        return;
    }
    memcpy(u, held->u, p * sizeof(double));
    memcpy(held->y, sample->y, p * sizeof(double));
    if (!all_finite(sample->y, p)) {
        if (*held->begun == 0.0) {
            told->status |= STATUS_HELD;
            return;
        }
        estimate(ipid, held);
        for (size_t i = 0; i < p; ++i)
            if (!isfinite(held->y[i])) held->y[i] = ahead(ipid, held, i);
        told->status |= STATUS_EXPECTED;
    }
    if (*held->begun < 0.0) take_over(ipid, held, sample->setpoint);
    observe(ipid, held, held->y);
    if (!all_finite(sample->reference, p)) {
        told->status |= STATUS_HELD;
        return;
    }
    estimate(ipid, held);
    for (size_t i = 0; i < p; ++i) {
        const double error = sample->reference[i] - held->y[i];
        const double integral = held->integral[i] + ipid->sampling_time * error;
        held->correction[i] = ipid->kp * error + ipid->ki * integral - held->estimates[ipid->order * p + i];
        if (ipid->order > 1) held->correction[i] -= ipid->kd * held->estimates[p + i];
    }
    for (size_t j = 0; j < p; ++j) {
        held->u[j] = dot(ipid->inverse + j * p, held->correction, p);
        u[j] = clip(held->u[j], held->limits[j], held->limits[p + j]);
    }
    for (size_t i = 0; i < p; ++i) {
        bool limited = false;
        for (size_t j = 0; j < p; ++j)
            if (ipid->inverse[j * p + i] != 0.0 && u[j] != held->u[j]) limited = true;
        if (!limited) held->integral[i] += ipid->sampling_time * (sample->reference[i] - held->y[i]);
    }
    memcpy(held->u, u, p * sizeof(double));
}
