/* Measurements that are paid for, as outputs without a reference: what Predicted does in Python. */
#ifndef PAID_H
#define PAID_H

#include "sample.h"

typedef struct {
    size_t p, more, horizon; /* controlled outputs, paid measurements, samples */
    const size_t *measured;  /* numbers of the latter */
} Paid;

/* `memory` has room for (2 + horizon) (p + more) values; the references of the further outputs are zero there. */
Sample with_paid(const Paid *paid, const Sample *sample, double memory[]);

#endif
