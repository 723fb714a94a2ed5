#include "wkpc.h"

#include "ahead.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

/* Start as if the plant had always been where it is. */
static void rest(const Wkpc *wkpc, const WkpcMemory *held, const Sample *sample)
{
    fill_window(held->y, wkpc->past, wkpc->p, sample->y);
    if (sample->applied != NULL) fill_window(held->u, wkpc->past, wkpc->m, sample->applied);
    fill_window(held->samples, wkpc->depth, wkpc->q, sample->measured);
    lift(wkpc->terms, wkpc->term_count, held->samples, held->state);
    fill_window(held->z, wkpc->past, wkpc->lifted, held->state);
    double *d = held->reference + wkpc->horizon * wkpc->p;
    fill_window(d, wkpc->past, wkpc->disturbances, d + wkpc->past * wkpc->disturbances);
    *held->resting = 0.0;
}

/* What is missing is as predicted, or as it was last. */
static void complete(const Wkpc *wkpc, const WkpcMemory *held, const double forecast[])
{
    for (size_t i = 0; i < wkpc->p; ++i) {
        if (!isfinite(held->now[i])) held->now[i] = forecast[i];
    }
    for (size_t i = 0; i < wkpc->shared; ++i) held->newest[wkpc->measured[i]] = held->now[wkpc->outputs[i]];
}

void step_wkpc(const Wkpc *wkpc, const WkpcMemory *held, const Sample *sample, double u[], Told *told)
{
    const size_t p = wkpc->p, q = wkpc->q, m = wkpc->m;
    const double *last_u = held->u + (wkpc->past - 1) * m, *forecast = held->y + (wkpc->past - 1) * p;
    const bool missing = !all_finite(sample->y, p) || !all_finite(sample->measured, q);
    if (*held->resting != 0.0) {
        if (missing) {
            told->status |= STATUS_HELD;
            memcpy(u, last_u, m * sizeof(double));
            return;
        }
        rest(wkpc, held, sample);
    }
    if (missing) told->status |= STATUS_EXPECTED;
    memcpy(held->reference, sample->reference, wkpc->horizon * p * sizeof(double));
    if (sample->applied != NULL) {
        memcpy(u, sample->applied, m * sizeof(double));
    } else if (solve_law(wkpc->law, held->z, held->law, held->answer, told)) {
        memcpy(u, held->answer, m * sizeof(double));
        if (wkpc->near) keep_limits(u, held->reference + wkpc->horizon * p + wkpc->ahead + 1, m, wkpc->near, m);
        forecast = held->answer + m;
    } else {
        memcpy(u, last_u, m * sizeof(double));
    }
    memcpy(held->now, sample->y, p * sizeof(double));
    if (missing) complete(wkpc, held, forecast);
    for (size_t i = 0; i < q; ++i) {
        if (isfinite(sample->measured[i])) held->newest[i] = sample->measured[i];
    }
    append_sample(held->u, wkpc->past, m, u);
    append_sample(held->y, wkpc->past, p, held->now);
    if (wkpc->disturbances) forget_oldest(held->reference + wkpc->horizon * p, wkpc->past, wkpc->disturbances);
    prepend_sample(held->samples, wkpc->depth, q, held->newest);
    lift(wkpc->terms, wkpc->term_count, held->samples, held->state);
    append_sample(held->z, wkpc->past, wkpc->lifted, held->state);
}
