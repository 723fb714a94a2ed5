#include "koopman.h"

#include "vectors.h"

#include <string.h>

static void put(bool always, double window[], size_t length, size_t width, const double sample[])
{
    if (always) fill_window(window, length, width, sample);
    else prepend_sample(window, length, width, sample);
}

/* Take the next sample; before the first one all was as it is now. */
static void follow(const Koopman *koopman, const KoopmanMemory *held, const double y[], const double measured[])
{
    const bool first = *held->begun == 0.0;
    const size_t delays = koopman->delays, p = koopman->p;
    if (delays) {
        put(first, held->past, delays + 1, p, y);
        put(first, held->past + (delays + 1) * p, delays, koopman->m, held->u);
    }
    put(first, held->states, koopman->depth, koopman->size, delays ? held->past : measured);
    lift(koopman->terms, koopman->term_count, held->states, held->z);
    const size_t width = koopman->disturbances, size = koopman->remembered * width;
    const double *d = held->y + p, *last = d + width;
    double *before = held->y + p + 2 * width;
    if (size) {
        put(first, before, koopman->remembered, width, first ? d : last);
        memcpy(held->z + koopman->lifted - size, before, size * sizeof(double));
    }
    if (width) add_product(koopman->at_once, d, koopman->lifted, width, held->z);
}

void step_koopman(const Koopman *koopman, const KoopmanMemory *held, const Sample *sample, double u[], Told *told)
{
    const size_t n = koopman->lifted, m = koopman->m;
    const bool begun = *held->begun != 0.0;
    if (sample->applied != NULL && !begun) memcpy(held->u, sample->applied, m * sizeof(double));
    if (koopman->delays ? all_finite(sample->y, koopman->p) : all_finite(sample->measured, koopman->q)) {
        follow(koopman, held, sample->y, sample->measured);
        for (size_t i = 0; begun && i < n; ++i)
            held->disturbance[i] += koopman->gain * (held->z[i] - held->predicted[i]);
    } else if (begun) {
        told->status |= STATUS_EXPECTED;
        memcpy(held->z, held->predicted, n * sizeof(double));
        for (size_t i = 0; koopman->disturbances && i < n; ++i)
            held->z[i] -= dot(koopman->at_once + i * koopman->disturbances, held->y + koopman->p, koopman->disturbances);
        multiply(koopman->c, held->z, koopman->p, n, held->y);
        follow(koopman, held, held->y, held->z);
    } else {
        told->status |= STATUS_HELD;
        memcpy(u, held->u, m * sizeof(double));
        return;
    }
    *held->begun = 1.0;
    if (sample->applied != NULL) memcpy(u, sample->applied, m * sizeof(double));
    else solve_predictor(koopman->predictor, held->z, held->u, sample->reference, held->predictor, u, told);
    memcpy(held->predicted, held->disturbance, n * sizeof(double));
    add_product(koopman->a, held->z, n, n, held->predicted);
    add_product(koopman->b, u, n, m, held->predicted);
    if (koopman->disturbances) {
        double *d = held->y + koopman->p;
        add_product(koopman->e, d, n, koopman->disturbances, held->predicted);
        memcpy(d + koopman->disturbances, d, koopman->disturbances * sizeof(double));
    }
    memcpy(held->u, u, m * sizeof(double));
}
