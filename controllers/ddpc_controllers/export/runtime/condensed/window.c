#include "window.h"

#include <math.h>
#include <string.h>

#include "ahead.h"
#include "vectors.h"

/* The parts of the memory. */
typedef struct {
    double *u, *y, *reference, *d;
    double *limits; /* NULL where they stand */
    double *resting, *left, *forecast, *answer, *law;
} Parts;

static Parts parts_of(const Window *window, double memory[])
{
    const size_t outputs = window->steps * window->p, inputs = window->steps * window->m;
    Parts parts;
    parts.u = memory;
    parts.y = parts.u + window->past_u * window->m;
    parts.reference = parts.y + window->past_y * window->p;
    parts.d = parts.reference + window->horizon * window->p;
    parts.resting = parts.d + window->ahead + 1;
    parts.limits = NULL;
    if (window->near != NULL) {
        parts.limits = parts.resting;
        parts.resting += 2 * inputs;
    }
    parts.left = parts.resting + 1;
    parts.forecast = parts.left + 1;
    parts.answer = parts.forecast + outputs;
    parts.law = parts.answer + inputs + outputs;
    return parts;
}

/* Append the outputs, those forecast in place of missing ones. */
static void append_outputs(const Window *window, const Parts *parts, const double y[])
{
    const size_t p = window->p;
    double *newest = parts->y + (window->past_y - 1) * p;
    append_sample(parts->y, window->past_y, p, y);
    for (size_t i = 0; i < p; ++i) {
        if (!isfinite(newest[i])) newest[i] = parts->forecast[i];
    }
}

/* Keep the planned inputs, and their changes from the last ones on, within limits. */
static void hold_changes(const Window *window, const double limits[], const double last[], double plan[])
{
    const size_t m = window->m, inputs = window->steps * m;
    const double *low = limits ? limits : window->low, *high = limits ? limits + inputs : window->high;
    for (size_t k = 0; k < inputs; k += m, last = plan, plan += m) {
        for (size_t i = 0; i < m; ++i) {
            const double rate = window->rates[i];
            plan[i] = clip(clip(plan[i], last[i] - rate, last[i] + rate), low[k + i], high[k + i]);
        }
    }
}

/* Plan anew; false where the last inputs are to be held. */
static bool plan(const Window *window, const Parts *parts, const Sample *sample, const double last[], Told *told)
{
    const size_t inputs = window->steps * window->m, outputs = window->steps * window->p;
    Told own = {0, 0, 0};
    memcpy(parts->reference, sample->reference, window->horizon * window->p * sizeof(double));
    const bool solved = solve_law(window->law, parts->u, parts->law, parts->answer, &own);
    told->status |= own.status;
    told->iterations += own.iterations;
    told->active_bounds += own.active_bounds;
    if (!solved) return false;
    memcpy(parts->forecast, parts->answer + inputs, outputs * sizeof(double));
    if (parts->limits) keep_limits(parts->answer, parts->limits, inputs, window->near, window->m);
    hold_changes(window, parts->limits, last, parts->answer);
    if (own.status == 0) *parts->left = (double)(window->steps - 1);
    return true;
}

void step_window(const Window *window, double memory[], const Sample *sample, double u[], Told *told)
{
    const Parts parts = parts_of(window, memory);
    const size_t m = window->m, p = window->p;
    const double *last = parts.u + (window->past_u - 1) * m;
    const bool missing = !all_finite(sample->y, p);
    const double *next = last;
    if (*parts.resting != 0.0) {
        if (missing) {
            memcpy(u, last, m * sizeof(double));
            told->status |= STATUS_EXPECTED;
            return;
        }
        fill_window(parts.y, window->past_y, p, sample->y);
        if (sample->applied != NULL) fill_window(parts.u, window->past_u, m, sample->applied);
        fill_window(parts.d, window->past_u, window->disturbances, parts.d + window->past_u * window->disturbances);
        *parts.resting = 0.0;
    } else if (window->current) {
        append_outputs(window, &parts, sample->y);
    }
    if (sample->applied != NULL) {
        next = sample->applied;
    } else if (*parts.left > 0.0) {
        next = parts.answer + (window->steps - (size_t)*parts.left) * m;
        memmove(parts.forecast, parts.forecast + p, (window->steps - 1) * p * sizeof(double));
        *parts.left -= 1.0;
    } else if (plan(window, &parts, sample, last, told)) {
        next = parts.answer;
    }
    memcpy(u, next, m * sizeof(double));
    append_sample(parts.u, window->past_u, m, u);
    if (window->disturbances) forget_oldest(parts.d, window->past_u, window->disturbances);
    if (!window->current) append_outputs(window, &parts, sample->y);
    if (missing) told->status |= STATUS_EXPECTED;
}
