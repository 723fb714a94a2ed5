/* A margin to bands, and references at an edge of them: band_edge.py. */
#ifndef BAND_EDGE_H
#define BAND_EDGE_H

#include "sample.h"

typedef struct {
    size_t bands, samples; /* how many, and over how many samples, of which the first is now */
    const double *margin;  /* of each band */
} Margins;

typedef struct {
    size_t p, samples, bands;
    const size_t *outputs; /* those that are wanted within bands */
    size_t end;            /* the edge that is followed: 0 the lower one, 1 the upper one */
} Edge;

/* Draw bands in at both edges, at most to their middle: samples x bands x (lower, upper). */
void draw_in(const Margins *margins, double bands[]);

/* Return a sample whose references are the edges of bands, where there are any. `line` has room for samples x p. */
Sample follow_edge(const Edge *edge, const double bands[], const Sample *sample, double line[]);

#endif
