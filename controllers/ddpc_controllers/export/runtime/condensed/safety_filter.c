#include "safety_filter.h"

#include <math.h>
#include <string.h>

#include "ahead.h"
#include "vectors.h"

/* The parts of the law's parameters. */
typedef struct {
    double *u, *y, *wanted, *d;
    double *limits; /* NULL where they stand */
} Parts;

static Parts parts_of(const SafetyFilter *filter, double parameters[])
{
    Parts parts;
    parts.u = parameters;
    parts.y = parts.u + filter->past * filter->m;
    parts.wanted = parts.y + (filter->past + 1) * filter->p;
    parts.d = parts.wanted + filter->m;
    parts.limits = filter->near != NULL ? parts.d + filter->ahead + 1 : NULL;
    return parts;
}

/* Append the outputs, those forecast in place of missing ones. */
static void append_outputs(const SafetyFilter *filter, double window[], const double y[], const double forecast[])
{
    const size_t p = filter->p;
    double *newest = window + filter->past * p;
    append_sample(window, filter->past + 1, p, y);
    for (size_t i = 0; i < p; ++i) {
        if (!isfinite(newest[i])) newest[i] = forecast[i];
    }
}

/* Change the inputs that are wanted as far as it takes; return whether it takes any change. */
static bool change_inputs(const SafetyFilter *filter, const SafetyFilterMemory *held, double u[], Told *told)
{
    const Parts parts = parts_of(filter, held->parameters);
    const size_t m = filter->m;
    const double *low = parts.limits ? parts.limits : filter->low;
    const double *high = parts.limits ? parts.limits + m : filter->high;
    bool differs = false;
    for (size_t i = 0; i < m; ++i) u[i] = parts.wanted[i] = clip(u[i], low[i], high[i]);
    if (!solve_law(filter->law, held->parameters, held->law, held->answer, told)) return false;
    memcpy(held->forecast, held->answer + m, filter->p * sizeof(double));
    if (parts.limits) keep_limits(held->answer, parts.limits, m, filter->near, m);
    for (size_t i = 0; i < m; ++i) differs = differs || fabs(held->answer[i] - u[i]) > filter->same;
    if (differs) memcpy(u, held->answer, m * sizeof(double));
    return differs;
}

bool take_wanted(const SafetyFilter *filter, const SafetyFilterMemory *held, const Sample *sample, double u[])
{
    const size_t m = filter->m;
    if (sample->applied != NULL) memcpy(u, sample->applied, m * sizeof(double));
    if (!all_finite(u, m)) return false;
    memcpy(held->unscaled, u, m * sizeof(double));
    for (size_t i = 0; i < m; ++i) u[i] /= filter->scale[i];
    return true;
}

void filter_inputs(
    const SafetyFilter *filter, const SafetyFilterMemory *held, const Sample *sample, double u[], Told *told)
{
    const Parts parts = parts_of(filter, held->parameters);
    const size_t p = filter->p, past = filter->past, disturbances = filter->disturbances;
    const bool missing = !all_finite(sample->y, p);
    *held->changed = 0.0;
    if (missing) told->status |= STATUS_EXPECTED;
    if (*held->resting == 0.0) {
        append_outputs(filter, parts.y, sample->y, held->forecast);
    } else if (missing) {
        return; /* nothing is known of the plant yet */
    } else {
        fill_window(parts.y, past + 1, p, sample->y);
        if (sample->applied != NULL) fill_window(parts.u, past, filter->m, u);
        fill_window(parts.d, past, disturbances, parts.d + past * disturbances);
        *held->resting = 0.0;
    }
    if (sample->applied != NULL) memcpy(held->forecast, sample->y, p * sizeof(double));
    else if (change_inputs(filter, held, u, told)) *held->changed = 1.0;
    append_sample(parts.u, past, filter->m, u);
    if (disturbances) forget_oldest(parts.d, past, disturbances);
}

void give_wanted(const SafetyFilter *filter, const SafetyFilterMemory *held, double u[])
{
    if (*held->changed == 0.0) memcpy(u, held->unscaled, filter->m * sizeof(double));
}
