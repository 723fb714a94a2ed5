/* What is known of the time ahead: disturbances, bands, prices and limits that move. */
#ifndef AHEAD_H
#define AHEAD_H

#include <stddef.h>

/* The numbers that are taken at a sample, and for each the one that stands in where it is not known. */
typedef struct {
    size_t n;
    const size_t *places, *before;
} Known;

/* Some of these numbers, and what they are multiplied by. */
typedef struct {
    size_t n;
    const size_t *places;
    const double *factors;
    double far; /* stands for what is infinite, or 1e30 and more */
} Chosen;

/* Take what is known; NaN is not. Rows come after those that stand in for them. */
void take_known(const Known *known, const double values[], double ahead[]);

/* chosen[i] = factors[i] ahead[places[i]] */
void choose_ahead(const Chosen *chosen, const double ahead[], double values[]);

/* Keep n inputs within limits, first the lower ones and then the upper ones; those that are at a limit but for `near`,
 * of which there are m, are exactly there. */
void keep_limits(double u[], const double limits[], size_t n, const double near[], size_t m);

#endif
