#include "models.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

Model *create(const char *kind)
{
    static const char *const names[] = {"lag", "ball", "stair", "relay"};
    Model *m = calloc(1, sizeof *m);
    for (int i = 0; i < 4; i++)
        if (strcmp(kind, names[i]) == 0) {
            m->kind = (Kind)i;
            m->next_event = -1.0;
            m->values[X] = m->kind == BALL ? 1.0 : 0.0;
            m->values[GRAVITY] = 9.81;
            m->values[RESTITUTION] = 0.7;
            m->values[RATE] = 1.0;
            return m;
        }
    free(m);
    return NULL;
}

size_t states(const Model *m) { return m->kind == STAIR ? 0 : m->kind == BALL ? 2 : 1; }

size_t indicators(const Model *m) { return m->kind == BALL ? 1 : 0; }

void initialise(Model *m)
{
    if (m->kind == STAIR)
        m->next_event = m->time + 1.0;
}

void derivatives(Model *m, double dx[])
{
    double *v = m->values;
    switch (m->kind) {
    case LAG: v[DX] = v[RATE] * (v[U] - v[X]); break;
    case BALL: v[DX] = v[V]; v[DV] = v[U] - v[GRAVITY]; break;
    case RELAY: v[DX] = v[RATE]; break;
    case STAIR: return;
    }
    dx[0] = v[DX];
    if (m->kind == BALL)
        dx[1] = v[DV];
}

void event_indicators(const Model *m, double z[]) { z[0] = m->values[X]; }

int handle_event(Model *m)
{
    double *v = m->values;
    if (m->kind == BALL && v[X] <= 0.0 && v[V] < 0.0) {
        v[X] = 1e-300;
        v[V] = -v[RESTITUTION] * v[V];
        v[COUNT] += 1.0;
        return 1;
    }
    if (m->kind == STAIR && m->time >= m->next_event) {
        v[COUNT] += 1.0;
        m->next_event += 1.0;
        m->terminate = v[COUNT] >= 10.0;
    }
    if (m->kind == RELAY && v[X] > 1.0) {
        v[X] -= 1.0;
        v[COUNT] += 1.0;
        return 1;
    }
    return 0;
}

int completed_step(const Model *m) { return m->kind == RELAY && m->values[X] > 1.0; }

int step(Model *m, double h)
{
    double *v = m->values;
    m->time += h;
    if (m->kind == LAG)
        v[X] = v[U] + (v[X] - v[U]) * exp(-v[RATE] * h);
    while (m->kind == STAIR && !m->terminate && m->time >= m->next_event)
        handle_event(m);
    return m->terminate ? 2 : 0;
}

int is_writable(unsigned reference) { return reference != COUNT && reference != DX && reference != DV; }
