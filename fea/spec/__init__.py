"""What a bundle says, read key by key and checked; knows no mesh."""
