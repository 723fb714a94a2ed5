/* The lifted state: its newest sample, and observables of it and its past. */
#ifndef LIFT_H
#define LIFT_H

#include <stddef.h>

typedef enum {
    MONOMIALS,   /* products of the coordinates whose numbers are given, `size` each */
    THIN_PLATES, /* |x - c| log10 |x - c|, with centres c of the first `size` coordinates */
    GAUSSIANS    /* exp(-|x - c|^2 / spread), likewise */
} TermKind;

typedef struct {
    TermKind kind;
    size_t count, size;
    const size_t *factors; /* count x size, of monomials */
    const double *centres; /* count x size, of the others */
    double spread;
} Term;

/* z = all terms, one after another. */
void lift(const Term *const terms[], size_t count, const double x[], double z[]);

#endif
