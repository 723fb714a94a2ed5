#include "koopman.h"

#include "vectors.h"

#include <string.h>

/* The parts of the memory. */
typedef struct {
    double *begun, *u, *z, *disturbance, *predicted, *past, *states, *y, *predictor;
} Parts;

static Parts parts_of(const Koopman *koopman, double memory[])
{
    Parts parts = {.begun = memory, .u = memory + 1};
    parts.z = parts.u + koopman->m;
    parts.disturbance = parts.z + koopman->lifted;
    parts.predicted = parts.disturbance + koopman->lifted;
    parts.past = parts.predicted + koopman->lifted;
    parts.states = parts.past + (koopman->delays ? koopman->size : 0);
    parts.y = parts.states + koopman->depth * koopman->size;
    parts.predictor = parts.y + koopman->p;
    return parts;
}

static void put(bool always, double window[], size_t length, size_t width, const double sample[])
{
    if (always) fill_window(window, length, width, sample);
    else prepend_sample(window, length, width, sample);
}

/* Take the next sample; before the first one all was as it is now. */
static void follow(const Koopman *koopman, const Parts *parts, const double y[], const double measured[])
{
    const bool first = *parts->begun == 0.0;
    const size_t delays = koopman->delays, p = koopman->p;
    if (delays) {
        put(first, parts->past, delays + 1, p, y);
        put(first, parts->past + (delays + 1) * p, delays, koopman->m, parts->u);
    }
    put(first, parts->states, koopman->depth, koopman->size, delays ? parts->past : measured);
    lift(koopman->terms, koopman->term_count, parts->states, parts->z);
}

void step_koopman(const Koopman *koopman, double memory[], const Sample *sample, double u[], Told *told)
{
    const size_t n = koopman->lifted, m = koopman->m;
    const Parts parts = parts_of(koopman, memory);
    const bool begun = *parts.begun != 0.0;
    if (koopman->delays ? all_finite(sample->y, koopman->p) : all_finite(sample->measured, koopman->q)) {
        follow(koopman, &parts, sample->y, sample->measured);
        for (size_t i = 0; begun && i < n; ++i)
            parts.disturbance[i] += koopman->gain * (parts.z[i] - parts.predicted[i]);
    } else if (begun) {
        told->status |= STATUS_EXPECTED;
        multiply(koopman->c, parts.predicted, koopman->p, n, parts.y);
        follow(koopman, &parts, parts.y, parts.predicted);
    } else {
        told->status |= STATUS_HELD;
        memcpy(u, parts.u, m * sizeof(double));
        return;
    }
    *parts.begun = 1.0;
    solve_predictor(koopman->predictor, parts.z, parts.u, sample->reference, parts.predictor, u, told);
    memcpy(parts.predicted, parts.disturbance, n * sizeof(double));
    add_product(koopman->a, parts.z, n, n, parts.predicted);
    add_product(koopman->b, u, n, m, parts.predicted);
    memcpy(parts.u, u, m * sizeof(double));
}
