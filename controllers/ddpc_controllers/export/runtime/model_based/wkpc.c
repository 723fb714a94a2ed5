#include "wkpc.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

/* The parts of the memory. */
typedef struct {
    double *z, *u, *y, *reference;
    double *resting, *samples, *newest, *answer, *state, *now, *law;
} Parts;

static Parts parts_of(const Wkpc *wkpc, double memory[])
{
    Parts parts = {.z = memory};
    parts.u = parts.z + wkpc->past * wkpc->lifted;
    parts.y = parts.u + wkpc->past * wkpc->m;
    parts.reference = parts.y + wkpc->past * wkpc->p;
    parts.resting = parts.reference + wkpc->horizon * wkpc->p + 1;
    parts.samples = parts.resting + 1;
    parts.newest = parts.samples + wkpc->depth * wkpc->q;
    parts.answer = parts.newest + wkpc->q;
    parts.state = parts.answer + wkpc->m + wkpc->p;
    parts.now = parts.state + wkpc->lifted;
    parts.law = parts.now + wkpc->p;
    return parts;
}

/* Start as if the plant had always been where it is. */
static void rest(const Wkpc *wkpc, const Parts *parts, const Sample *sample)
{
    fill_window(parts->y, wkpc->past, wkpc->p, sample->y);
    fill_window(parts->samples, wkpc->depth, wkpc->q, sample->measured);
    lift(wkpc->terms, wkpc->term_count, parts->samples, parts->state);
    fill_window(parts->z, wkpc->past, wkpc->lifted, parts->state);
    *parts->resting = 0.0;
}

/* What is missing is as predicted, or as it was last. */
static void complete(const Wkpc *wkpc, const Parts *parts, const double forecast[])
{
    for (size_t i = 0; i < wkpc->p; ++i) {
        if (!isfinite(parts->now[i])) parts->now[i] = forecast[i];
    }
    for (size_t i = 0; i < wkpc->shared; ++i) parts->newest[wkpc->measured[i]] = parts->now[wkpc->outputs[i]];
}

void step_wkpc(const Wkpc *wkpc, double memory[], const Sample *sample, double u[], Told *told)
{
    const size_t p = wkpc->p, q = wkpc->q, m = wkpc->m;
    const Parts parts = parts_of(wkpc, memory);
    const double *last_u = parts.u + (wkpc->past - 1) * m, *forecast = parts.y + (wkpc->past - 1) * p;
    const bool missing = !all_finite(sample->y, p) || !all_finite(sample->measured, q);
    if (*parts.resting != 0.0) {
        if (missing) {
            told->status |= STATUS_HELD;
            memcpy(u, last_u, m * sizeof(double));
            return;
        }
        rest(wkpc, &parts, sample);
    }
    if (missing) told->status |= STATUS_EXPECTED;
    memcpy(parts.reference, sample->reference, wkpc->horizon * p * sizeof(double));
    if (solve_law(wkpc->law, memory, parts.law, parts.answer, told)) {
        memcpy(u, parts.answer, m * sizeof(double));
        forecast = parts.answer + m;
    } else {
        memcpy(u, last_u, m * sizeof(double));
    }
    memcpy(parts.now, sample->y, p * sizeof(double));
    if (missing) complete(wkpc, &parts, forecast);
    for (size_t i = 0; i < q; ++i) {
        if (isfinite(sample->measured[i])) parts.newest[i] = sample->measured[i];
    }
    append_sample(parts.u, wkpc->past, m, u);
    append_sample(parts.y, wkpc->past, p, parts.now);
    prepend_sample(parts.samples, wkpc->depth, q, parts.newest);
    lift(wkpc->terms, wkpc->term_count, parts.samples, parts.state);
    append_sample(parts.z, wkpc->past, wkpc->lifted, parts.state);
}
