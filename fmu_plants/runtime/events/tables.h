/* Tables of numbers over time, read from the CSV files in an FMU's resources. */
#ifndef TABLES_H
#define TABLES_H

#include "instance.h"

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    const char *file;          /* below resources; its first column is the time in s */
    size_t n_columns;
    const char *const *heads;  /* of the columns that are read */
    bool held;                 /* values hold until the next row; otherwise they change in straight lines */
    double period;             /* after which the rows come again; 0: before and after them, values are held */
} TableSource;

/* A table, and the piece between two of its rows that a simulation is in. */
typedef struct {
    const TableSource *source;
    double *times;    /* per row, strictly increasing */
    double *rows;     /* n_columns values per row */
    size_t n_rows;
    size_t n_pieces;  /* rows that a piece begins at: all, but for a last one that a period ends at */
    size_t row;       /* that the present piece begins at */
    double since;     /* time that `value` belongs to */
    double until;     /* where the next piece begins, INFINITY after the last one */
    double *value;    /* of each column at `since` */
    double *slope;
} Table;

/* The tables, read from the folder of the resources; NULL if that fails, which is logged. */
Table *tables_read(const TableSource sources[], size_t n, const char *folder, const Instance *instance,
                   const char *function);
void tables_free(Table tables[], size_t n);

/* Be in the piece that a time lies in; where a piece begins, that one. */
void table_go_to(Table *table, double time);

/* The columns at a time, by the line of the present piece. */
void table_values(const Table *table, double time, double values[]);

#endif
